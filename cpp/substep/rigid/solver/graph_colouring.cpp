#include "substep/rigid/solver/graph_colouring.h"

#include <algorithm>
#include <array>
#include <bit>

#include "substep/core/errors.h"
#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

constexpr std::int64_t kPacketsPerChunk = 16;
constexpr std::int64_t kSmallColour = 16;  // packets: up to so many are done faster by one thread
constexpr std::int64_t kSmallSweep = 48;   // the same for all together

constexpr int kColours = GraphColouring::kPairColours + GraphColouring::kGroundColours;

bool on_ground(const BodyPair& pair) { return pair.a < 0 || pair.b < 0; }

}  // namespace

void GraphColouring::colour(std::span<const BodyPair> constraints, std::int32_t bodies,
                            std::span<std::uint8_t> colours) {
  for (auto& used : used_) used.assign(usize(bodies), 0);
  const auto mask = [&](const BodyPair& pair, const std::vector<std::uint64_t>& used) {
    return (pair.a < 0 ? 0 : used[usize(pair.a)]) | (pair.b < 0 ? 0 : used[usize(pair.b)]);
  };
  const auto take = [&](const BodyPair& pair, std::vector<std::uint64_t>& used, int bit) {
    if (pair.a >= 0) used[usize(pair.a)] |= std::uint64_t{1} << bit;
    if (pair.b >= 0) used[usize(pair.b)] |= std::uint64_t{1} << bit;
  };
  for (std::size_t c = 0; c < constraints.size(); ++c) {
    const BodyPair& pair = constraints[c];
    if (pair.a < 0 && pair.b < 0) throw InputError("a constraint needs a body that can move");
    const int first = on_ground(pair) ? kPairColours : 0, bit = colours[c] - first;
    auto& used = used_[on_ground(pair)];
    if (bit < 0 || bit >= 64 || (mask(pair, used) >> bit & 1) != 0) {
      colours[c] = kNoColour;
    } else {
      take(pair, used, bit);
    }
  }
  for (std::size_t c = 0; c < constraints.size(); ++c) {
    if (colours[c] != kNoColour) continue;
    const BodyPair& pair = constraints[c];
    auto& used = used_[on_ground(pair)];
    const int bit = std::countr_one(mask(pair, used));
    if (bit == 64) continue;
    take(pair, used, bit);
    colours[c] = static_cast<std::uint8_t>((on_ground(pair) ? kPairColours : 0) + bit);
  }
}

// Each goes into the first packet behind those of its bodies that has a lane left.
void GraphColouring::append_uncoloured(std::span<const BodyPair> constraints, std::int32_t bodies,
                                       std::span<const std::uint8_t> colours, Sweep& sweep) {
  last_.assign(usize(bodies), -1);
  filled_.clear();
  for (std::size_t c = 0; c < constraints.size(); ++c) {
    if (colours[c] < kColours) continue;
    const auto [a, b] = constraints[c];
    auto k = usize(1 + std::max(a < 0 ? -1 : last_[usize(a)], b < 0 ? -1 : last_[usize(b)]));
    while (k < filled_.size() && filled_[k] == sweep.lanes) ++k;
    if (k == filled_.size()) {
      filled_.push_back(0);
      sweep.constraint.resize(sweep.constraint.size() + usize(sweep.lanes), -1);
    }
    const auto lane = usize(filled_[k]++);
    sweep.constraint[k * usize(sweep.lanes) + lane] = static_cast<std::int32_t>(c);
    if (a >= 0) last_[usize(a)] = static_cast<std::int32_t>(k);
    if (b >= 0) last_[usize(b)] = static_cast<std::int32_t>(k);
  }
}

void GraphColouring::make_sweep(std::span<const BodyPair> constraints, std::int32_t bodies,
                                std::span<const std::uint8_t> colours, int lanes, Sweep& sweep) {
  sweep.lanes = lanes;
  sweep.constraint.clear();
  std::array<std::int64_t, kColours> count{};
  std::array<std::uint64_t, kColours / 64> used{};  // bits of the colours that are
  std::size_t uncoloured = 0;
  for (const std::uint8_t colour : colours) {
    if (colour < kColours) {
      ++count[colour];
      used[colour / 64] |= std::uint64_t{1} << colour % 64;
    } else {
      ++uncoloured;
    }
  }
  if (uncoloured > 0) append_uncoloured(constraints, bodies, colours, sweep);

  std::array<std::int64_t, kColours> next;  // lane of the next constraint of a colour that is used
  const auto each_colour = [&](const auto& task) {
    for (std::size_t word = 0; word < used.size(); ++word)
      for (std::uint64_t bits = used[word]; bits != 0; bits &= bits - 1)
        task(64 * word + usize(std::countr_zero(bits)));
  };
  const std::int64_t coloured = sweep.packets();
  std::int64_t packets = coloured;
  each_colour([&](std::size_t k) {
    next[k] = packets * lanes;
    packets += (count[k] + lanes - 1) / lanes;
  });
  sweep.constraint.resize(usize(packets * lanes), -1);
  for (std::size_t c = 0; c < colours.size(); ++c) {
    if (colours[c] >= kColours) continue;
    sweep.constraint[usize(next[colours[c]]++)] = static_cast<std::int32_t>(c);
  }

  sweep.chunk_start.assign(1, 0);
  sweep.phase_start.assign(1, 0);
  bool one_by_one = false;  // the last phase is one chunk, which may grow
  const auto add = [&](std::int64_t end, bool small) {
    if (small && one_by_one) {
      sweep.chunk_start.back() = end;
      return;
    }
    while (sweep.chunk_start.back() < end) {
      sweep.chunk_start.push_back(
          small ? end : std::min(end, sweep.chunk_start.back() + kPacketsPerChunk));
    }
    sweep.phase_start.push_back(static_cast<std::int64_t>(sweep.chunk_start.size()) - 1);
    one_by_one = small;
  };
  if (coloured > 0) add(coloured, true);
  each_colour([&](std::size_t k) {
    const std::int64_t own = (count[k] + lanes - 1) / lanes;
    add((next[k] + lanes - 1) / lanes, own <= kSmallColour || packets <= kSmallSweep);
  });
  sweep.chunks_of_phase.clear();
  for (std::size_t f = 0; f + 1 < sweep.phase_start.size(); ++f) {
    sweep.chunks_of_phase.push_back(sweep.phase_start[f + 1] - sweep.phase_start[f]);
  }
}

}  // namespace substep::rigid
