// Loops over particles that also sum, in an order that no number of threads changes.
#pragma once

#include <cstdint>
#include <vector>

#include "substep/core/parallel.h"

namespace substep::pbf {

// Particles a task works on.
inline constexpr std::int64_t kGrain = 512;

// particle(i) for all i in [0, n).
template <class Particle>
void for_particles(std::int64_t n, const Particle& particle, int threads) {
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) particle(i);
      },
      threads);
}

// The same; returns the sum of what it returns (a number or anything with +=), chunk by chunk.
template <class Particle>
auto ordered_sum(std::int64_t n, const Particle& particle, int threads) {
  using Sum = decltype(particle(std::int64_t{}));
  std::vector<Sum> parts(n > 0 ? (n - 1) / kGrain + 1 : 0);
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        Sum part{};
        for (std::int64_t i = begin; i < end; ++i) part += particle(i);
        parts[begin / kGrain] = part;
      },
      threads);
  Sum sum{};
  for (const Sum& part : parts) sum += part;
  return sum;
}

}  // namespace substep::pbf
