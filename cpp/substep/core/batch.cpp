#include "substep/core/batch.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"

namespace substep {

void SimulationBatch::step(std::span<const double> sizes, std::span<const double> times,
                           std::int64_t count) {
  call_ = Call::kStep;
  sizes_ = sizes;
  times_ = times;
  run(count);
}

void SimulationBatch::advance(std::span<const double> ends) {
  call_ = Call::kAdvance;
  times_ = ends;
  run(1);
}

void SimulationBatch::advance_once(std::span<const double> ends, bool first) {
  call_ = Call::kAdvanceOnce;
  times_ = ends;
  first_ = first;
  run(1);
}

void SimulationBatch::take_step(std::int64_t w, std::int64_t) {
  Simulation& world = *worlds_[usize(w)];
  const double end = times_[usize(w)];
  if (call_ == Call::kAdvance) return advance_whole(world, end);
  if (call_ == Call::kAdvanceOnce) {
    if (world.time() < end) world.advance_once(end, first_);
    return;
  }
  const double dt = sizes_[usize(w)];
  if (std::isnan(dt)) world.step_by_limit();
  if (dt > 0) world.step(dt);
  if (!std::isnan(end)) world.set_time(end);
}

void SimulationBatch::advance_whole(Simulation& world, double end) const {
  try {
    world.advance(end);
  } catch (const SolverError&) {
    if (!mask) world.rewind();
    throw;
  } catch (...) {
    const DeferInterrupts whole;
    world.rewind();
    throw;
  }
}

double SimulationBatch::time() const {
  double going = std::numeric_limits<double>::infinity(), all = going;
  for (std::int64_t w = 0; w < size(); ++w) {
    all = std::min(all, time_of(w));
    if (failure(w).empty()) going = std::min(going, time_of(w));
  }
  return std::isfinite(going) ? going : all;
}

}  // namespace substep
