// The order of a Gauss-Seidel sweep: which constraints are projected at once, and in which block of
// lanes each stands. Greedy, in the order of the constraints, so always the same.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/pbd/groups/partition.h"

namespace substep::pbd {

struct Schedule {
  // constraint[lanes * block + lane], -1 where a block is not full: no two of a block share a
  // particle.
  std::vector<std::int32_t> constraint;
  // Blocks of patch p: [patch_start[p], patch_start[p + 1]), to be projected in their order.
  std::vector<std::int64_t> patch_start;
  // Blocks of chunk c: [chunk_start[c], chunk_start[c + 1]), for constraints between patches; the
  // chunks of phase f are [phase_start[f], phase_start[f + 1]) and share no particle.
  std::vector<std::int64_t> chunk_start, phase_start;

  int phases() const { return static_cast<int>(phase_start.size()) - 1; }
};

// particles: `points` slots for each constraint, one behind the other.
Schedule make_schedule(std::span<const std::int32_t> particles, int points, int lanes,
                       const Partition& partition);

}  // namespace substep::pbd
