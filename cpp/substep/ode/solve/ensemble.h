// Many solutions of one method at once: members go over the threads of the pool, and each is
// solved by itself, so its bits depend neither on the others nor on the number of threads.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "substep/ode/solve/integration.h"

namespace substep::ode {

struct Member {
  enum Status { kDone, kFailed, kNonFinite, kTooManySteps } status = kDone;
  std::string message;
  double time = 0;          // where it ended
  std::int64_t index = -1;  // the component at fault, where there is one
  std::int64_t steps = 0, evaluations = 0;
};

struct Ensemble {
  std::string_view method;
  StepOptions options;         // y: members rows of `size` initial values
  std::vector<double> t_eval;  // empty: the end state alone
  std::int64_t members = 0, size = 0, max_steps = 0;
  int threads = 0;
};

// system(i) gives member i's right-hand side and may be called from any thread. out holds for each
// member size rows of the times of t_eval, or the end state; times that a member did not reach are
// left alone, and the end state of a member that failed is its last good step.
std::vector<Member> solve_ensemble(
    const Ensemble& ensemble, const std::function<std::shared_ptr<System>(std::int64_t)>& system,
    double* out);

}  // namespace substep::ode
