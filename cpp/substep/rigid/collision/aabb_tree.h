// A tree of boxes along the axes, eight children to a node, for queries with a box or along a way.
//
// A box that moves is written into its place and the boxes above it grow, in about 20 ns; nothing
// shrinks. By the surface area heuristic (Goldsmith, Salmon 1987; MacDonald, Booth 1990) the nodes
// that a query visits are as many as the sum of their areas over that of the root, so the tree is
// built anew when the growth has added half of what was there, or when many boxes were added:
// these wait in nodes of no parent. What a query finds does not depend on the shape of the tree,
// only the order does.
#pragma once

#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/lanes.h"
#include "substep/core/usize.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

// A box of float32, rounded outwards, so that it holds what it was made from; beyond the range of
// float32 the largest numbers stand for all others.
struct TreeBox {
  float low[3], high[3];

  bool overlaps(const TreeBox& other) const {
    bool apart = false;
    for (int i = 0; i < 3; ++i) apart |= (low[i] > other.high[i]) | (other.low[i] > high[i]);
    return !apart;
  }
  bool holds(const Bounds& bounds) const {
    bool inside = true;
    for (int i = 0; i < 3; ++i) inside &= (low[i] <= bounds.low[i]) & (bounds.high[i] <= high[i]);
    return inside;
  }
};
TreeBox tree_box(const Bounds& bounds);
TreeBox empty_tree_box();  // overlaps nothing

// The points origin + t direction, 0 <= t <= length, widened by half_lengths along the axes.
struct TreeRay {
  TreeRay(const Vec3& origin, const Vec3& direction, double length,
          const Vec3& half_lengths = Vec3::Zero());

  float low[3], high[3];  // bounds of the origin, rounded outwards
  float inverse[3];       // of the direction, large where that is 0
  float length;
};

class AabbTree {
 public:
  // id >= 0: any number that is not in the tree, or set(): is.
  void add(std::int32_t id, const TreeBox& box);
  void set(std::int32_t id, const TreeBox& box);
  void remove(std::int32_t id);
  // numbers[id]: what the box is called from now on.
  void renumber(std::span<const std::int32_t> numbers);

  // Builds the tree anew where that pays. Call it before many queries.
  void tidy();
  // So that adding so many boxes with ids below `end` does not take memory.
  void make_room(std::int32_t end, std::int32_t count);

  // Calls visit(id) for the boxes that overlap with `box`.
  template <class Visit>
  void query(const TreeBox& box, Visit&& visit) const;

  // Calls visit(id) for the boxes that a ray meets and its neighbours by rounding, roughly from
  // near to far; visit returns the length that the ray has from now on.
  template <class Visit>
  void cast(TreeRay ray, Visit&& visit) const;

  std::int64_t size() const { return count_; }
  std::size_t bytes() const;

 private:
  static constexpr int kWide = 8;
  using Lanes = Vector<float, 4 * kWide>;
  struct alignas(32) Node {
    Lanes low[3], high[3];      // of the children; low > high where there is none
    std::int32_t child[kWide];  // a node; ~id of a box
    std::int32_t parent;        // node * kWide + lane, -1: none
  };
  struct Item {
    TreeBox box;
    std::int32_t id;
  };
  static constexpr int kStack =
      640;  // depth is below 77, as no side of a split has under a quarter

  static unsigned overlapping(const Node& node, const TreeBox& box);
  static unsigned met(const Node& node, const TreeRay& ray, Lanes& at);

  std::int32_t new_node(std::int32_t parent);
  void put(std::int32_t place, const TreeBox& box);
  TreeBox box_at(std::int32_t place) const;
  void build();
  TreeBox build(std::int32_t node, Item* items, std::int64_t count);

  std::vector<Node> nodes_;          // the root first
  std::vector<std::int32_t> loose_;  // nodes of boxes that were added since
  std::vector<std::int32_t> place_;  // of each id: node * kWide + lane, -1: none
  std::vector<Item> items_;
  std::int64_t count_ = 0, changes_ = 0;
  int last_loose_ = kWide;        // lanes in use of the last loose node
  double area_ = 0, growth_ = 0;  // [m^2], sum over the nodes' boxes
};

// Lanes that are set.
inline unsigned lane_bits(const Vector<std::int32_t, 32>& mask) {
#ifdef __AVX__
  return static_cast<unsigned>(_mm256_movemask_ps(reinterpret_cast<__m256>(mask)));
#else
  unsigned bits = 0;
  for (unsigned lane = 0; lane < 8; ++lane) bits |= static_cast<unsigned>(mask[lane] != 0) << lane;
  return bits;
#endif
}

inline unsigned AabbTree::overlapping(const Node& node, const TreeBox& box) {
  auto hit =
      (node.low[0] <= splat<Lanes>(box.high[0])) & (node.high[0] >= splat<Lanes>(box.low[0]));
  for (int i = 1; i < 3; ++i) {
    hit &= (node.low[i] <= splat<Lanes>(box.high[i])) & (node.high[i] >= splat<Lanes>(box.low[i]));
  }
  return lane_bits(hit);
}

// Slabs: the ray is between the planes of axis i for t from (near_i - o_i) / d_i to (far_i - o_i) /
// d_i. A relative 1e-6 covers the rounding (Ize, "Robust BVH ray traversal", JCGT 2013).
inline unsigned AabbTree::met(const Node& node, const TreeRay& ray, Lanes& at) {
  Lanes enter{}, leave = splat<Lanes>(ray.length);
  for (int i = 0; i < 3; ++i) {
    const Lanes to_low = (node.low[i] - ray.high[i]) * ray.inverse[i];
    const Lanes to_high = (node.high[i] - ray.low[i]) * ray.inverse[i];
    const Lanes first = ray.inverse[i] < 0 ? to_high : to_low;
    const Lanes last = ray.inverse[i] < 0 ? to_low : to_high;
    enter = first > enter ? first : enter;
    leave = last < leave ? last : leave;
  }
  at = enter;
  const auto hit = (enter * 0.999999f <= leave * 1.000001f) & (node.low[0] <= node.high[0]);
  return lane_bits(hit);
}

template <class Visit>
void AabbTree::query(const TreeBox& box, Visit&& visit) const {
  std::int32_t stack[kStack];
  int top = 0;
  const auto open = [&](std::int32_t index) {
    const Node& node = nodes_[usize(index)];
    for (unsigned lanes = overlapping(node, box); lanes != 0; lanes &= lanes - 1) {
      const std::int32_t child = node.child[std::countr_zero(lanes)];
      if (child < 0) {
        visit(~child);
      } else {
        stack[top++] = child;
      }
    }
  };
  if (!nodes_.empty()) open(0);
  while (top > 0) open(stack[--top]);
  for (const std::int32_t node : loose_) open(node);
}

template <class Visit>
void AabbTree::cast(TreeRay ray, Visit&& visit) const {
  struct Entry {
    std::int32_t node;
    float at;
  };
  Entry stack[kStack];
  int top = 0;
  const auto open = [&](std::int32_t index) {
    const Node& node = nodes_[usize(index)];
    Lanes at;
    const int first = top;
    for (unsigned lanes = met(node, ray, at); lanes != 0; lanes &= lanes - 1) {
      const int lane = std::countr_zero(lanes);
      const std::int32_t child = node.child[lane];
      if (child < 0) {
        ray.length = static_cast<float>(visit(~child)) * 1.000001f;
        continue;
      }
      int k = top++;  // the nearest on top
      for (; k > first && stack[k - 1].at < at[lane]; --k) stack[k] = stack[k - 1];
      stack[k] = {child, at[lane]};
    }
  };
  for (const std::int32_t node : loose_) open(node);
  if (!nodes_.empty()) open(0);
  while (top > 0) {
    const Entry entry = stack[--top];
    if (entry.at * 0.999999f <= ray.length) open(entry.node);
  }
}

}  // namespace substep::rigid
