// The exceptions of the core. cpp/bindings/core.cpp turns each into its Python twin of
// python/substep/errors.py; nothing else is thrown on purpose, and nothing aborts.
#pragma once

#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

namespace substep {

// The caller passed something wrong; nothing was changed.
struct InputError : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

// The numbers failed: where, when, and what to do. The state is the last good step.
struct SolverError : std::runtime_error {
  explicit SolverError(const std::string& message, double time_ = std::nan(""),
                       std::int64_t index_ = -1, std::int64_t step_ = -1)
      : std::runtime_error(message), time(time_), index(index_), step(step_) {}
  double time;         // [s], NaN when it has no meaning
  std::int64_t index;  // component, particle or row; -1 when it has no meaning
  std::int64_t step;   // -1 when it has no meaning
};
struct NonFiniteError : SolverError {
  using SolverError::SolverError;
};
struct ConvergenceError : SolverError {
  using SolverError::SolverError;
  std::vector<double> residuals;  // of each iteration, in the units of the stop rule
};
struct SingularMatrixError : SolverError {
  using SolverError::SolverError;
};

}  // namespace substep
