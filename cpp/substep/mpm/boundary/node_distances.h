// Signed distances and normals of the colliders at the nodes near to them, kept until a collider or
// the blocks change: so a collider at rest costs a comparison per node block, and 16 bytes per node
// that it holds.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/geometry/collider.h"
#include "substep/mpm/boundary/surfaces.h"
#include "substep/transfer/blocks.h"

namespace substep::mpm {

template <class Real, int D>
class NodeDistances {
 public:
  static constexpr int kNodes = transfer::NodeBlocks<Real, D>::kNodes;
  // Of one node block: per node the outward normal n (in 2D: n_z = 0), and the signed distance less
  // the reach [m]: the node takes the condition where that is at most 0. (Nodes that surely do not
  // may have any positive number instead, and no normal.)
  struct alignas(64) Patch {
    Real values[kNodes * 4];
  };

  // Nodes take the condition of a collider below distance `reach` [m] from it.
  NodeDistances(double cell, double reach) : cell_(cell), reach_(reach) {}

  // After every sort, and then for all colliders; else for those that moved since.
  void update(const transfer::BlockLayout<D>& layout, bool layout_changed,
              std::span<const geometry::Collider> colliders, int threads);

  // A surface that some nodes of a block take the condition of, and its patch there.
  struct Held {
    std::int32_t surface;
    std::int32_t patch;
  };
  // Those of a node block, ascending by their surfaces.
  std::span<const Held> held(std::int32_t node_block) const {
    const auto first = usize(starts_[usize(node_block)]),
               end = usize(starts_[usize(node_block) + 1]);
    return std::span(held_).subspan(first, end - first);
  }
  const Patch& patch(const Held& held) const {
    return fields_[usize(held.surface)].patches[usize(held.patch)];
  }
  // All surfaces, ascending by their colliders.
  std::span<const Surface> all() const { return surfaces_; }

 private:
  static constexpr std::size_t kPose = 7;  // position and orientation: Collider::state() begins so
  struct Field {
    std::array<double, kPose> pose{};  // that it was computed for
    std::int64_t shapes = 0;           // and of which shape
    std::vector<std::uint64_t> keys;   // of the node blocks with a patch, ascending
    std::vector<std::int32_t> blocks;  // and their numbers
    std::vector<Patch> patches;
  };
  // Finds the node blocks of surfaces that are to be found anew, and samples them: all where the
  // surface moved, else those that it had not before.
  void find_blocks(std::span<const std::uint64_t> keys,
                   std::span<const geometry::Collider> colliders,
                   std::span<const std::uint8_t> anew, int threads);
  void fill(std::span<const geometry::Collider> colliders, std::span<const std::uint8_t> anew,
            std::span<Field> before, int threads);
  void list_held(std::size_t blocks);

  double cell_, reach_;
  std::vector<Surface> surfaces_;
  std::vector<Field> fields_;         // of each surface
  std::vector<std::int32_t> starts_;  // of each node block, in held_
  std::vector<Held> held_;
};

}  // namespace substep::mpm
