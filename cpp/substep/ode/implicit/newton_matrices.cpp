#include "substep/ode/implicit/newton_matrices.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "substep/ode/implicit/matrix_kinds.h"
#include "substep/ode/stepping/combine.h"
#include "substep/ode/stepping/step_control.h"

namespace substep::ode {

NonFiniteError jacobian_not_finite(double t, std::int64_t row, std::int64_t column) {
  return NonFiniteError("the Jacobian is NaN or infinite at t = " + format(t) + ", row " +
                            std::to_string(row) + ", column " + std::to_string(column),
                        t, row);
}

SingularMatrixError singular_matrix(std::int64_t row) {
  return SingularMatrixError("no pivot in row " + std::to_string(row), std::nan(""), row);
}

void check_jacobian(double t, std::int64_t n, const SparsePattern* pattern,
                    const std::vector<double>& values) {
  if (all_finite(values.data(), static_cast<std::int64_t>(values.size()))) return;
  std::size_t k = 0;
  while (std::isfinite(values[k])) ++k;
  const auto entry = static_cast<std::int64_t>(k);
  if (!pattern) throw jacobian_not_finite(t, entry % n, entry / n);
  const auto after = std::upper_bound(pattern->start.begin(), pattern->start.end(), entry);
  throw jacobian_not_finite(t, pattern->row[k], after - pattern->start.begin() - 1);
}

SparsePattern full_pattern(std::int64_t n) {
  SparsePattern pattern;
  pattern.rows = pattern.cols = static_cast<std::int32_t>(n);
  for (std::int32_t j = 0; j < pattern.cols; ++j) {
    for (std::int32_t i = 0; i < pattern.rows; ++i) pattern.row.push_back(i);
    pattern.start.push_back(static_cast<std::int32_t>(pattern.row.size()));
  }
  return pattern;
}

std::unique_ptr<NewtonMatrices> make_newton_matrices(System& system, const StepOptions& options) {
  auto jacobian = options.jacobian ? options.jacobian : make_jacobian(system);
  if (options.linear_solver == LinearSolver::krylov) {
    return make_krylov_matrices(system, std::move(jacobian), options);
  }
  const bool sparse_mass = !options.mass || options.mass->pattern;
  if (jacobian->pattern() && sparse_mass) {
    if (options.linear_solver == LinearSolver::automatic && !options.mass)
      return make_automatic_matrices(system, std::move(jacobian), options);
    return make_sparse_matrices(system, std::move(jacobian), options.mass);
  }
  return make_dense_matrices(system, std::move(jacobian), options.mass);
}

}  // namespace substep::ode
