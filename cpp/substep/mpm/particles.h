// Particles of one material, sorted by particle block and cell, in packets of kLanes: number f of
// the particle in lane l of packet p is at values[(p * fields + f) * kLanes + l].
//
// Position x is in cells, from the first node of the arena of the particle's block: so its
// precision is the same everywhere. Packets do not cross blocks; the lanes after the last particle
// of a block repeat it, and are not scattered.
#pragma once

#include <cstdint>
#include <vector>

#include "substep/core/lanes.h"

namespace substep::mpm {

template <class Real>
inline constexpr int kLanes = kVectorBytes / static_cast<int>(sizeof(Real));

// Packets of one particle block.
struct Run {
  std::int64_t first = 0;  // packet
  std::int32_t packets = 0;
  std::int32_t count = 0;  // particles
};

template <class Real, int D>
struct ParticleGroup {
  // state: x (D), volume at rest V_0 [m^3], then the material's kFields<D>.
  static constexpr int kOwn = D + 1;
  int fields = 0;  // of state: kOwn + kFields<D>
  // motion: velocity v [m/s] (D), affine part C [1/s] (D x D, rows are components of v).
  static constexpr int kMotion = D + D * D;
  std::vector<Real> state, motion;  // aligned to 64 bytes by their owner
  std::vector<std::int32_t> ids;    // of each lane; -1: repeats
  std::vector<Run> runs;            // of each particle block; count 0 where it has none here
};

}  // namespace substep::mpm
