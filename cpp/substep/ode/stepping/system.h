// What an integrator sees of a problem: y' = f(t, y), and where it has the form x'' = a(t, x, v)
// also the acceleration, with y = [x, v].
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <string_view>
#include <vector>

#include "substep/core/errors.h"
#include "substep/linalg/sparse.h"

namespace substep::ode {

class Jacobian;
struct MassMatrix;
struct RkcStage;
class Stepper;

enum class LinearSolver { automatic, direct, krylov };

// How a Stepper goes from t to t_bound.
struct StepOptions {
  double t = 0.0;
  double t_bound = 0.0;
  const double* y = nullptr;          // size() initial values, copied
  double step = 0.0;                  // above 0: fixed step; else adaptive
  std::vector<double> rtol = {1e-3};  // one for all components, or one each
  std::vector<double> atol = {1e-6};
  double first_step = 0.0;  // 0: chosen by the problem
  double max_step = std::numeric_limits<double>::infinity();
  bool complex_pairs = false;       // y holds (real, imaginary) pairs: norms take the modulus
  int threads = 0;                  // for systems with a kernel of their own; 0: default
  bool local_extrapolation = true;  // explicit methods with step doubling: adds the estimate

  // RKC2 only: a bound of the spectral radius of df/dy; none: the system's, else an estimate.
  std::function<double(double t, const double* y)> spectral_radius;

  // Implicit methods only.
  std::shared_ptr<Jacobian> jacobian;      // null: the system's own, else finite differences
  std::shared_ptr<const MassMatrix> mass;  // of M y' = f; null: M = 1
  LinearSolver linear_solver = LinearSolver::automatic;
};

// `steps` equal steps of a method; y is overwritten. Step k goes from t + (first + k) h to
// t + (first + k + 1) h, so that times do not depend on how a long run is cut up.
struct FixedRun {
  std::string_view method;
  double t;
  double h;
  std::int64_t steps;
  double* y;
  int threads;  // 0: default
  std::int64_t first = 0;
  double* a = nullptr;  // methods of symplectic.h: the acceleration, as it was and as it is
};

class System {
 public:
  System() = default;
  System(const System&) = delete;
  System& operator=(const System&) = delete;
  virtual ~System() = default;

  virtual std::int64_t size() const = 0;
  virtual void rhs(double t, const double* y, double* dydt) = 0;

  // True where rhs needs no interpreter and may be called from several threads at once.
  virtual bool native() const { return true; }

  // x'' = a(t, x, v) with d = size() / 2 components, for systems that say so.
  virtual bool second_order() const { return false; }
  virtual void acceleration(double /*t*/, const double* /*x*/, const double* /*v*/, double* /*a*/) {
    throw InputError("this system is not of second order");
  }

  // df/dy, where the system has it: n^2 values column by column or, if there is a pattern, its
  // nonzeros in order. A pattern without has_jacobian() serves finite differences.
  virtual bool has_jacobian() const { return false; }
  virtual const SparsePattern* jacobian_pattern() const { return nullptr; }
  virtual void jacobian(double /*t*/, const double* /*y*/, double* /*values*/) {
    throw InputError("this system has no Jacobian of its own");
  }

  // out = (df/dy)(t, y) v, where that is cheaper than a product with the matrix.
  virtual bool has_jacobian_product() const { return false; }
  virtual void jacobian_product(double /*t*/, const double* /*y*/, const double* /*v*/,
                                double* /*out*/) {
    throw InputError("this system has no product with its Jacobian");
  }

  // Runs the steps with a kernel of the system's own (force and stages fused) and returns true, or
  // returns false and leaves y alone. What is not finite may stay in y: the caller looks.
  virtual bool fixed_steps(const FixedRun& /*run*/) { return false; }

  // An upper bound of the spectral radius of df/dy, below 0 where the system knows none.
  virtual double spectral_radius(double /*t*/, const double* /*y*/) { return -1.0; }

  // A stage of RKC2 with a kernel of the system's own (f and the sum in one pass), or false.
  virtual bool rkc_stage(const RkcStage& /*stage*/) { return false; }

  // True where fixed_steps polls for Ctrl-C itself, so that runs may be long.
  virtual bool polls() const { return false; }

  // A stepper of a method of methods.h for this system, which must outlive it.
  virtual std::unique_ptr<Stepper> make_stepper(std::string_view method,
                                                const StepOptions& options);
};

}  // namespace substep::ode
