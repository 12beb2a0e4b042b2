// The order of a Gauss-Seidel sweep over contacts and joints, in packets of lanes.
//
// Two constraints conflict if they share a body that can move. Each constraint gets the least
// colour that no conflicting one has, in the order of the constraints (greedy colouring), so at
// most 1 + (conflicts of the constraint) colours are needed, and the order is always the same.
// Colours of constraints between two bodies come first, then those against the ground: what comes
// last is fulfilled best, and a pile stands on its ground. What finds no colour among kPairColours
// (a body with very many contacts) is swept before all others, one packet after the other.
//
// Compare the constraint graph of Box2D v3 (Catto, "SIMD Matters", box2d.org, 2024), which keeps
// its colours from step to step and sweeps the overflow without lanes.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/rigid/motion/body_pair.h"

namespace substep::rigid {

// Packet k holds the constraints constraint[lanes * k ... lanes * (k + 1)), -1 where it is not
// full; no two of them share a body. Chunk c holds the packets [chunk_start[c], chunk_start[c +
// 1]), to be done in their order, and phase f the chunks [phase_start[f], phase_start[f + 1]),
// which share no body: parallel_phases() over chunks_of_phase gives the same bits for any threads.
struct Sweep {
  int lanes = 1;
  std::vector<std::int32_t> constraint;
  std::vector<std::int64_t> chunk_start, phase_start, chunks_of_phase;

  std::int64_t packets() const { return static_cast<std::int64_t>(constraint.size()) / lanes; }
};

class GraphColouring {
 public:
  static constexpr int kPairColours = 64;    // 0 ... 63
  static constexpr int kGroundColours = 64;  // 64 ... 127
  static constexpr std::uint8_t kNoColour = 255;

  // Gives every constraint a colour; bodies: numbers are below this. A constraint that comes with a
  // colour keeps it (where two in conflict come with the same, the first does): so the order of the
  // old ones does not change as others come and go, but then the colours are part of the state. For
  // a sweep that depends on the constraints alone let all be kNoColour. It stays kNoColour where
  // all colours are taken. A constraint between two unmovable bodies is an InputError.
  void colour(std::span<const BodyPair> constraints, std::int32_t bodies,
              std::span<std::uint8_t> colours);

  // The sweep in the order of the colours, and of the constraints within each.
  void make_sweep(std::span<const BodyPair> constraints, std::int32_t bodies,
                  std::span<const std::uint8_t> colours, int lanes, Sweep& sweep);

 private:
  void append_uncoloured(std::span<const BodyPair> constraints, std::int32_t bodies,
                         std::span<const std::uint8_t> colours, Sweep& sweep);

  std::vector<std::uint64_t> used_[2];  // of each body: bits of its pair and of its ground colours
  std::vector<std::int32_t> last_;      // packet of each body
  std::vector<int> filled_;             // lanes of each packet
};

}  // namespace substep::rigid
