// df/dy for the implicit methods: where it comes from, dense or sparse.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "substep/ode/system.h"

namespace substep::ode {

// The nonzeros of a square matrix column by column: rows row[start[j]] .. row[start[j + 1] - 1] of
// column j, rising.
struct SparsityPattern {
  std::int32_t size = 0;
  std::vector<std::int32_t> start, row;

  std::int32_t nonzeros() const { return start.empty() ? 0 : start.back(); }
};

// The constant matrix M of M y' = f(t, y): n^2 values column by column, or those of a pattern.
struct MassMatrix {
  std::unique_ptr<const SparsityPattern> pattern;  // null: dense
  std::vector<double> values;
};

// Where df/dy is wanted.
struct JacobianPoint {
  double t = 0.0;
  double h = 0.0;  // the step that it is for
  const double* y = nullptr;
  const double* f = nullptr;      // f(t, y)
  const double* scale = nullptr;  // atol + rtol |y|
};

class Jacobian {
 public:
  Jacobian() = default;
  Jacobian(const Jacobian&) = delete;
  Jacobian& operator=(const Jacobian&) = delete;
  virtual ~Jacobian() = default;

  // Null where dense. evaluate() may replace it by another one that holds it.
  virtual const SparsityPattern* pattern() const = 0;
  virtual bool constant() const { return false; }
  virtual bool native() const { return true; }  // runs without the interpreter

  // As System::jacobian; returns how many evaluations of f it took.
  virtual std::int64_t evaluate(const JacobianPoint& at, std::vector<double>& values) = 0;
};

// The system's own, or finite differences: forward ones, column by column, or for a pattern in
// groups of columns that share no row.
std::shared_ptr<Jacobian> make_jacobian(System& system);
std::shared_ptr<Jacobian> make_finite_differences(System& system,
                                                  std::unique_ptr<const SparsityPattern> pattern);

// Group of each column so that no two columns of a group have a nonzero in the same row, by the
// first-fit of Curtis, Powell and Reid, J. Inst. Maths Applics 13 (1974) 117-119.
std::vector<std::int32_t> group_columns(const SparsityPattern& pattern);

}  // namespace substep::ode
