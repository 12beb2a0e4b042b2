// Where particles are stored: in patches, which are neighbours in space and fit a core's cache. A
// constraint within a patch is projected by the thread that has the patch, without waiting for
// others; only those between patches need a colour of their own.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/point.h"

namespace substep::pbd {

struct Partition {
  std::vector<std::int32_t> id;           // of each slot: the user's index of a particle
  std::vector<std::int32_t> slot;         // of each id: its row in the arrays
  std::vector<std::int64_t> patch_start;  // slots of patch p: [patch_start[p], patch_start[p + 1])

  std::int64_t patches() const { return static_cast<std::int64_t>(patch_start.size()) - 1; }
  std::int64_t patch_of(std::int64_t slot) const;
};

// Halves of the particles along the longest side of their box, again and again, until a patch has
// at most `largest`: recursive coordinate bisection (Berger and Bokhari 1987). Particles of a patch
// keep their order.
template <class Real>
Partition make_partition(std::span<const Point<Real>> x, std::int64_t largest);

}  // namespace substep::pbd
