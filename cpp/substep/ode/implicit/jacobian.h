// df/dy for the implicit methods: where it comes from, dense or sparse.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "substep/linalg/sparse.h"
#include "substep/ode/stepping/system.h"

namespace substep::ode {

// The constant matrix M of M y' = f(t, y): n^2 values column by column, or those of a pattern.
struct MassMatrix {
  std::unique_ptr<const SparsePattern> pattern;  // null: dense
  std::vector<double> values;

  void multiply(std::int64_t n, const double* x, double* out) const;  // out = M x
};

// Where df/dy is wanted.
struct JacobianPoint {
  double t = 0.0;
  double h = 0.0;  // the step that it is for
  const double* y = nullptr;
  const double* f = nullptr;      // f(t, y)
  const double* scale = nullptr;  // atol + rtol |y|
  bool algebraic = false;         // M y' = f: the step says nothing about how y changes
};

class Jacobian {
 public:
  Jacobian() = default;
  Jacobian(const Jacobian&) = delete;
  Jacobian& operator=(const Jacobian&) = delete;
  virtual ~Jacobian() = default;

  // Null where dense. evaluate() may replace it by another one that holds it.
  virtual const SparsePattern* pattern() const = 0;
  virtual bool constant() const { return false; }
  virtual bool native() const { return true; }  // runs without the interpreter

  // As System::jacobian; returns how many evaluations of f it took.
  virtual std::int64_t evaluate(const JacobianPoint& at, std::vector<double>& values) = 0;
};

// The system's own, or finite differences: forward ones, column by column, or for a pattern in
// groups of columns that share no row.
std::shared_ptr<Jacobian> make_jacobian(System& system);
std::shared_ptr<Jacobian> make_finite_differences(System& system,
                                                  std::unique_ptr<const SparsePattern> pattern);

// Group of each column so that no two columns of a group have a nonzero in the same row, by the
// first-fit of Curtis, Powell and Reid, J. Inst. Maths Applics 13 (1974) 117-119.
std::vector<std::int32_t> group_columns(const SparsePattern& pattern);

}  // namespace substep::ode
