#include "substep/pbd/groups/colouring.h"

#include <algorithm>
#include <bit>

#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

constexpr std::int64_t kBlocksPerChunk = 64;
constexpr std::int64_t kSerialBlocks = 256;  // fewer than these in all are one chunk

// Colours constraints greedily: the least colour that none of its particles has yet, 64 colours at
// a time. Calls take(constraint, colour).
class Colouring {
 public:
  explicit Colouring(std::size_t particles) : used_(particles, 0) {}

  // Lists of constraints by colour.
  std::vector<std::vector<std::int32_t>> operator()(std::vector<std::int32_t> constraints,
                                                    std::span<const std::int32_t> particles,
                                                    std::size_t points) {
    std::vector<std::vector<std::int32_t>> colours;
    while (!constraints.empty()) {
      const std::size_t first = colours.size();
      std::vector<std::int32_t> left;
      for (const std::int32_t c : constraints) {
        const auto held = particles.subspan(usize(c) * points, points);
        std::uint64_t taken = 0;
        for (const std::int32_t p : held) taken |= used_[usize(p)];
        if (taken == ~std::uint64_t{0}) {
          left.push_back(c);
          continue;
        }
        const auto colour = usize(std::countr_one(taken));
        for (const std::int32_t p : held) {
          used_[usize(p)] |= std::uint64_t{1} << colour;
        }
        if (colours.size() <= first + colour) colours.resize(first + colour + 1);
        colours[first + colour].push_back(c);
      }
      for (const std::int32_t c : constraints) {
        for (std::size_t k = 0; k < points; ++k) {
          used_[usize(particles[usize(c) * points + k])] = 0;
        }
      }
      constraints.swap(left);
    }
    return colours;
  }

 private:
  std::vector<std::uint64_t> used_;  // bits of the colours that hold a particle
};

}  // namespace

Schedule make_schedule(std::span<const std::int32_t> particles, int points, int lanes,
                       const Partition& partition) {
  const auto width = usize(points);
  const std::size_t m = particles.size() / width;
  std::vector<std::int32_t> patch_of(partition.id.size());
  for (std::int64_t p = 0; p < partition.patches(); ++p) {
    const auto at = usize(p);
    std::fill(patch_of.begin() + partition.patch_start[at],
              patch_of.begin() + partition.patch_start[at + 1], static_cast<std::int32_t>(p));
  }
  std::vector<std::vector<std::int32_t>> inside(usize(partition.patches()));
  std::vector<std::int32_t> between;
  for (std::size_t c = 0; c < m; ++c) {
    const auto patch = [&](std::size_t k) { return patch_of[usize(particles[c * width + k])]; };
    bool one = true;
    for (std::size_t k = 1; k < width; ++k) one &= patch(k) == patch(0);
    (one ? inside[usize(patch(0))] : between).push_back(static_cast<std::int32_t>(c));
  }

  Schedule s;
  const auto blocks = [&] { return static_cast<std::int64_t>(s.constraint.size()) / lanes; };
  const auto append = [&](const std::vector<std::int32_t>& colour) {
    s.constraint.insert(s.constraint.end(), colour.begin(), colour.end());
    while (s.constraint.size() % usize(lanes) != 0) s.constraint.push_back(-1);
  };
  Colouring colour(partition.id.size());
  s.patch_start.push_back(0);
  for (auto& own : inside) {
    for (const auto& list : colour(std::move(own), particles, width)) append(list);
    s.patch_start.push_back(blocks());
  }
  const auto count = static_cast<std::int64_t>(between.size());
  const auto colours = colour(std::move(between), particles, width);
  const bool serial = count <= kSerialBlocks * lanes;
  s.chunk_start.push_back(blocks());
  s.phase_start.push_back(0);
  for (const auto& list : colours) {
    std::int64_t begin = blocks();
    append(list);
    if (serial) continue;
    for (; begin < blocks(); begin = s.chunk_start.back()) {
      s.chunk_start.push_back(std::min(begin + kBlocksPerChunk, blocks()));
    }
    s.phase_start.push_back(static_cast<std::int64_t>(s.chunk_start.size()) - 1);
  }
  if (serial && !colours.empty()) {
    s.chunk_start.push_back(blocks());
    s.phase_start.push_back(1);
  }
  return s;
}

}  // namespace substep::pbd
