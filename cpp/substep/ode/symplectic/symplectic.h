// Fixed-step methods for x'' = a(t, x, v), [HLW] Hairer, Lubich, Wanner, "Geometric Numerical
// Integration", 2nd ed., 2006. With a_n = a(t_n, x_n, v_n) and step h:
//
//   symplectic Euler, [HLW] I (1.9):     v_{n+1} = v_n + h a_n,  x_{n+1} = x_n + h v_{n+1}
//   position Verlet, [HLW] I (1.15):     x_{n+1} - 2 x_n + x_{n-1} = h^2 a_n,
//                                        v_n = (x_{n+1} - x_{n-1}) / 2h,
//     kept as d_n = x_n - x_{n-1} (the summed form, [HLW] VIII.5); the start-up step
//     x_1 = x_0 + h v_0 + h^2/2 a_0 is the recurrence with d_0 = h v_0 - h^2/2 a_0
//   velocity Verlet, [HLW] I (1.17):     u = v_n + h/2 a_n,  x_{n+1} = x_n + h u,
//                                        v_{n+1} = u + h/2 a_{n+1}
//   Yoshida 4, Phys. Lett. A 150 (1990) 262, [HLW] II (4.4): velocity Verlet with steps
//     w1 h, w0 h, w1 h, where w1 = 1 / (2 - 2^(1/3)), w0 = 1 - 2 w1
//
// Where a depends on v, both Verlets evaluate a_{n+1} at the velocity predicted with a_n
// (Groot and Warren, J. Chem. Phys. 107 (1997) 4423, eq. 22 with lambda = 1); they keep order 2.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "substep/ode/stepping/system.h"

namespace substep::ode {

struct SymplecticMethod {
  std::string_view name;
  int order;        // for forces that do not depend on the velocity
  int evaluations;  // of a, per step
  bool symmetric;
};

enum Symplectic { kSymplecticEuler, kPositionVerlet, kVelocityVerlet, kYoshida4 };
inline constexpr std::array<SymplecticMethod, 4> kSymplecticMethods = {{
    {"symplectic_euler", 1, 1, false},
    {"position_verlet", 2, 1, true},
    {"velocity_verlet", 2, 1, true},
    {"yoshida4", 4, 3, true},
}};

// The method of that name, or -1.
int symplectic_method(std::string_view name);

// System::fixed_steps takes these names as well, with FixedRun::a. For position_verlet the second
// half of its y holds the increments d_n = x_n - x_{n-1} instead of v.

inline constexpr double kCubeRoot2 = 1.2599210498948731648;
inline constexpr double kYoshida1 = 1 / (2 - kCubeRoot2), kYoshida0 = 1 - 2 * kYoshida1;
inline constexpr std::array<double, 1> kVerletWeights = {1};
inline constexpr std::array<double, 3> kYoshidaWeights = {kYoshida1, kYoshida0, kYoshida1};

// The weights of the velocity Verlet steps that make up the method.
constexpr std::span<const double> verlet_weights(int method) {
  if (method == kYoshida4) return kYoshidaWeights;
  return kVerletWeights;
}

// One solution, advanced step by step. State is all of it: restoring a copy steps again alike.
class SymplecticStepper {
 public:
  struct State {
    std::vector<double> y;  // x, v
    std::vector<double> a;
    std::vector<double> d;  // position Verlet: x_n - x_{n-1} for steps of d_step
    double d_step = 0;
  };

  SymplecticStepper(System& system, int method, const double* x0, const double* v0, int threads);

  // The acceleration at the start. This and the steps throw NonFiniteError, which leaves a state
  // that is of no use.
  void start(double t0) { evaluate(t0, v(), 0); }
  void step(double t, double h);
  // `steps` steps from t0 + first h on in one go with the system's own kernel, which gives the bits
  // of step(); false, and nothing done, where it has none.
  bool run(double t0, double h, std::int64_t first, std::int64_t steps);

  State state;
  std::int64_t evaluations = 0;

  std::int64_t size() const { return n_; }  // of x
  const double* x() const { return state.y.data(); }
  const double* v() const { return state.y.data() + n_; }
  const double* a() const { return state.a.data(); }
  bool finite() const;

 private:
  void evaluate(double t, const double* velocity, int stage);
  void begin_increments(double h);
  template <class Task>
  void for_components(Task&& task) const;

  System& system_;
  int method_, threads_;
  std::int64_t n_;
  std::vector<double> w_;  // the velocity that a is evaluated at
};

}  // namespace substep::ode
