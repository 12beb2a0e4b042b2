#include "substep/ode/solve/ensemble.h"

#include <algorithm>
#include <numeric>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::ode {
namespace {

Member solve_member(const Ensemble& e, std::int64_t i, std::shared_ptr<System> system,
                    double* out) {
  Member member;
  StepOptions options = e.options;
  options.y += i * e.size;
  options.threads = 1;
  const bool end_only = e.t_eval.empty();
  Integration integration(std::move(system), e.method, options,
                          {.every_step = false, .t_eval = e.t_eval});
  try {
    integration.run(e.max_steps);
    if (!integration.stepper().finished()) {
      member.status = Member::kTooManySteps;
      member.message = "max_steps: the end was not reached";
    }
  } catch (const NonFiniteError& error) {
    member.status = Member::kNonFinite;
    member.message = error.what();
    member.index = error.index;
  } catch (const SolverError& error) {
    member.status = Member::kFailed;
    member.message = error.what();
    member.index = error.index;
  }
  const Stepper& stepper = integration.stepper();
  member.time = stepper.t();
  member.steps = stepper.steps();
  member.evaluations = stepper.evaluations();
  if (end_only) {
    std::copy_n(stepper.y(), e.size, out + i * e.size);
    return member;
  }
  const auto times = static_cast<std::int64_t>(e.t_eval.size());
  const auto reached = static_cast<std::int64_t>(integration.times().size());
  const double* states = integration.states().data();
  for (std::int64_t k = 0; k < reached; ++k) {
    for (std::int64_t j = 0; j < e.size; ++j) {
      out[(i * e.size + j) * times + k] = states[k * e.size + j];
    }
  }
  return member;
}

// A stride without a common divisor with n, near the golden section: the contiguous ranges of the
// threads then see cheap and expensive members alike, also where the cost rises with the index.
std::int64_t scattering_stride(std::int64_t n) {
  auto stride = static_cast<std::int64_t>(0.6180339887498949 * static_cast<double>(n)) | 1;
  while (std::gcd(stride, n) != 1) stride += 2;
  return stride;
}

}  // namespace

std::vector<Member> solve_ensemble(
    const Ensemble& ensemble, const std::function<std::shared_ptr<System>(std::int64_t)>& system,
    double* out) {
  const std::int64_t n = ensemble.members;
  std::vector<Member> members(usize(n));
  if (n == 0) return members;
  const std::int64_t stride = scattering_stride(n);
  parallel_chunks(
      n,
      [&](std::int64_t chunk) {
        const std::int64_t i = chunk * stride % n;
        members[usize(i)] = solve_member(ensemble, i, system(i), out);
      },
      ensemble.threads);
  return members;
}

}  // namespace substep::ode
