#include "substep/core/many_worlds.h"

#include <algorithm>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"

namespace substep {
namespace {
constexpr std::int64_t kBlock = 16;  // steps of a world in a row: what keeping its state costs less
}  // namespace

void ManyWorlds::run(std::int64_t count) {
  for (std::int64_t begin = 0; begin < count; begin += kBlock)
    run_block(begin, std::min(begin + kBlock, count));
}

// Steps from `begin` to `end`, counted in this call.
void ManyWorlds::run_block(std::int64_t begin, std::int64_t end) {
  reached_.assign(failures_.size(), begin);
  errors_.assign(failures_.size(), nullptr);
  const std::vector<std::string> failed_before = failures_;
  try {
    parallel_chunks(
        size(),
        [&](std::int64_t w) {
          if (failures_[usize(w)].empty()) keep_world(w);
          run_world(w, begin, end);
        },
        threads);
  } catch (...) {
    failures_ = failed_before;
    return_to(begin, begin);
    throw;
  }
  std::int64_t goal = end, first = -1;
  for (std::int64_t w = 0; w < size() && !mask; ++w) {
    if (reached_[usize(w)] >= goal) continue;
    goal = reached_[usize(w)];
    first = w;
  }
  if (first >= 0) {
    failures_ = failed_before;
    return_to(goal, begin);
  }
  done(goal - begin);
  if (first >= 0) raise(first, goal);
}

void ManyWorlds::run_world(std::int64_t w, std::int64_t begin, std::int64_t end) {
  if (!failures_[usize(w)].empty()) {
    reached_[usize(w)] = end;
    return;
  }
  for (std::int64_t s = begin; s < end; ++s) {
    try {
      take_step(w, s);
    } catch (const SolverError& error) {
      failures_[usize(w)] = error.what();
      errors_[usize(w)] = std::current_exception();
      return;
    }
    reached_[usize(w)] = s + 1;
  }
}

// Worlds that went further are as they were after step `goal`.
void ManyWorlds::return_to(std::int64_t goal, std::int64_t begin) {
  const DeferInterrupts whole;
  parallel_chunks(
      size(),
      [&](std::int64_t w) {
        if (reached_[usize(w)] <= goal || !failures_[usize(w)].empty()) return;
        put_back(w);
        run_world(w, begin, goal);
      },
      threads);
}

void ManyWorlds::raise(std::int64_t w, std::int64_t step) const {
  const double time = time_of(w);
  const auto text = [&](const SolverError& error) {
    return "world " + std::to_string(w) + ": " + error.what();
  };
  try {
    std::rethrow_exception(errors_[usize(w)]);
  } catch (const NonFiniteError& error) {
    throw NonFiniteError(text(error), time, w, step);
  } catch (const ConvergenceError& error) {
    ConvergenceError told(text(error), time, w, step);
    told.residuals = error.residuals;
    throw told;
  } catch (const SingularMatrixError& error) {
    throw SingularMatrixError(text(error), time, w, step);
  } catch (const SolverError& error) {
    throw SolverError(text(error), time, w, step);
  }
}

}  // namespace substep
