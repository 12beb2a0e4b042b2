// Counter-based random numbers: Philox4x32-10 (Salmon, Moraes, Dror, Shaw, "Parallel random
// numbers: as easy as 1, 2, 3", SC11). A number is a function of (key, counter), so a particle
// draws the same numbers whatever the thread that serves it.
#pragma once

#include <array>
#include <cstdint>

namespace substep {

using PhiloxCounter = std::array<std::uint32_t, 4>;
using PhiloxKey = std::array<std::uint32_t, 2>;

inline PhiloxCounter philox(PhiloxCounter c, PhiloxKey k) {
  constexpr std::uint64_t kM0 = 0xD2511F53u, kM1 = 0xCD9E8D57u;  // multipliers, section 3.4
  constexpr std::uint32_t kW0 = 0x9E3779B9u, kW1 = 0xBB67AE85u;  // Weyl sequence of the key
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t p0 = kM0 * c[0], p1 = kM1 * c[2];
    c = {static_cast<std::uint32_t>(p1 >> 32) ^ c[1] ^ k[0], static_cast<std::uint32_t>(p1),
         static_cast<std::uint32_t>(p0 >> 32) ^ c[3] ^ k[1], static_cast<std::uint32_t>(p0)};
    k[0] += kW0;
    k[1] += kW1;
  }
  return c;
}

// Two uniform doubles in [0, 1) with 53 bits each, for draw `index` of stream `seed`.
inline std::array<double, 2> uniform2(std::uint64_t seed, std::uint64_t index,
                                      std::uint64_t stream = 0) {
  const auto low = [](std::uint64_t v) { return static_cast<std::uint32_t>(v); };
  const auto high = [](std::uint64_t v) { return static_cast<std::uint32_t>(v >> 32); };
  const PhiloxCounter r =
      philox({low(index), high(index), low(stream), high(stream)}, {low(seed), high(seed)});
  const auto unit = [](std::uint32_t a, std::uint32_t b) {
    const std::uint64_t bits = (static_cast<std::uint64_t>(a) << 32 | b) >> 11;
    return static_cast<double>(bits) * 0x1p-53;
  };
  return {unit(r[0], r[1]), unit(r[2], r[3])};
}

}  // namespace substep
