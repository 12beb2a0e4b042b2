#include "substep/rigid/collision/aabb_tree.h"

#include <algorithm>
#include <array>
#include <cfloat>
#include <cmath>
#include <limits>

#include "substep/core/reserve.h"
#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

constexpr double kGrowth = 0.5;           // of the area, before the tree is built anew
constexpr std::int64_t kFewChanges = 32;  // added or removed, and n / kChangesShare
constexpr std::int64_t kChangesShare = 16;
constexpr int kBins = 16;
constexpr std::int64_t kFill = 6;  // boxes that are meant to be in a node without other nodes

float below(double x) {
  const auto f = static_cast<float>(std::clamp(x, -double{FLT_MAX}, double{FLT_MAX}));
  return std::max(f - (std::abs(f) * FLT_EPSILON + FLT_MIN), -FLT_MAX);
}
float above(double x) { return -below(-x); }

double area(const TreeBox& box) {
  const double x = double{box.high[0]} - box.low[0], y = double{box.high[1]} - box.low[1],
               z = double{box.high[2]} - box.low[2];
  return 2 * (x * y + y * z + z * x);
}

// The union; whether it is more than `box` was.
bool grow(TreeBox& box, const TreeBox& by) {
  bool grown = false;
  for (int i = 0; i < 3; ++i) {
    grown |= (by.low[i] < box.low[i]) | (by.high[i] > box.high[i]);
    box.low[i] = std::min(box.low[i], by.low[i]);
    box.high[i] = std::max(box.high[i], by.high[i]);
  }
  return grown;
}

float centre(const TreeBox& box, int axis) { return 0.5f * box.low[axis] + 0.5f * box.high[axis]; }

}  // namespace

TreeBox tree_box(const Bounds& bounds) {
  TreeBox box;
  for (int i = 0; i < 3; ++i) {
    box.low[i] = below(bounds.low[i]);
    box.high[i] = above(bounds.high[i]);
  }
  return box;
}

TreeBox empty_tree_box() {
  constexpr float kNone = std::numeric_limits<float>::infinity();
  return {{kNone, kNone, kNone}, {-kNone, -kNone, -kNone}};
}

TreeRay::TreeRay(const Vec3& origin, const Vec3& direction, double length_,
                 const Vec3& half_lengths)
    : length(above(length_)) {
  for (int i = 0; i < 3; ++i) {
    low[i] = below(origin[i] - half_lengths[i]);
    high[i] = above(origin[i] + half_lengths[i]);
    // So large that only what holds the origin in this axis is met, yet times 0 not NaN.
    const double inverse_i = 1 / direction[i];
    inverse[i] = static_cast<float>(direction[i] == 0 ? 1e30 : std::clamp(inverse_i, -1e30, 1e30));
  }
}

std::size_t AabbTree::bytes() const {
  return nodes_.capacity() * sizeof(Node) + items_.capacity() * sizeof(Item) +
         (place_.capacity() + loose_.capacity()) * sizeof(std::int32_t);
}

std::int32_t AabbTree::new_node(std::int32_t parent) {
  Node node;
  const TreeBox none = empty_tree_box();
  for (int i = 0; i < 3; ++i) {
    node.low[i] = splat<Lanes>(none.low[i]);
    node.high[i] = splat<Lanes>(none.high[i]);
  }
  std::fill(node.child, node.child + kWide, 0);
  node.parent = parent;
  nodes_.push_back(node);
  return static_cast<std::int32_t>(nodes_.size()) - 1;
}

void AabbTree::put(std::int32_t place, const TreeBox& box) {
  Node& node = nodes_[usize(place / kWide)];
  for (int i = 0; i < 3; ++i) {
    node.low[i][place % kWide] = box.low[i];
    node.high[i][place % kWide] = box.high[i];
  }
}

TreeBox AabbTree::box_at(std::int32_t place) const {
  const Node& node = nodes_[usize(place / kWide)];
  TreeBox box;
  for (int i = 0; i < 3; ++i) {
    box.low[i] = node.low[i][place % kWide];
    box.high[i] = node.high[i][place % kWide];
  }
  return box;
}

void AabbTree::make_room(std::int32_t end, std::int32_t count) {
  const auto nodes = usize(count / kWide + 2);
  reserve_amortised(place_, usize(end));
  reserve_amortised(nodes_, nodes_.size() + nodes);
  reserve_amortised(loose_, loose_.size() + nodes);
}

void AabbTree::add(std::int32_t id, const TreeBox& box) {
  if (usize(id) >= place_.size()) {
    place_.resize(usize(id) + 1, -1);
  }
  if (nodes_.empty()) new_node(-1);  // the root
  if (last_loose_ == kWide) {
    loose_.push_back(new_node(-1));
    last_loose_ = 0;
  }
  const std::int32_t place = loose_.back() * kWide + last_loose_++;
  place_[usize(id)] = place;
  nodes_[usize(place / kWide)].child[place % kWide] = ~id;
  put(place, box);
  ++count_;
  ++changes_;
}

void AabbTree::remove(std::int32_t id) {
  put(place_[usize(id)], empty_tree_box());
  place_[usize(id)] = -1;
  --count_;
  ++changes_;
}

void AabbTree::renumber(std::span<const std::int32_t> numbers) {
  std::vector<std::int32_t> places;
  for (std::size_t id = 0; id < place_.size(); ++id) {
    const std::int32_t place = place_[id], number = place < 0 ? -1 : numbers[id];
    if (number < 0) continue;
    if (usize(number) >= places.size()) {
      places.resize(usize(number) + 1, -1);
    }
    places[usize(number)] = place;
    nodes_[usize(place / kWide)].child[place % kWide] = ~number;
  }
  place_.swap(places);
}

void AabbTree::set(std::int32_t id, const TreeBox& box) {
  std::int32_t place = place_[usize(id)];
  put(place, box);
  while ((place = nodes_[usize(place / kWide)].parent) >= 0) {
    TreeBox upper = box_at(place);
    const double before = area(upper);
    if (!grow(upper, box)) break;
    growth_ += area(upper) - before;
    put(place, upper);
  }
}

void AabbTree::tidy() {
  if (changes_ > kFewChanges + count_ / kChangesShare || growth_ > kGrowth * area_) build();
}

void AabbTree::build() {
  items_.clear();
  for (std::size_t id = 0; id < place_.size(); ++id) {
    if (place_[id] >= 0) items_.push_back({box_at(place_[id]), static_cast<std::int32_t>(id)});
  }
  nodes_.clear();
  loose_.clear();
  last_loose_ = kWide;
  changes_ = 0;
  area_ = growth_ = 0;
  build(new_node(-1), items_.data(), static_cast<std::int64_t>(items_.size()));
}

namespace {

// Cuts the items in two by the surface area heuristic over the bins of the longest axis (Wald, "On
// fast construction of SAH-based bounding volume hierarchies", 2007), each with a quarter of them
// at least. Returns the size of the first part.
template <class Item>
std::int64_t split(Item* items, std::int64_t count) {
  std::array<float, 3> low, high;
  low.fill(FLT_MAX);
  high.fill(-FLT_MAX);
  for (std::int64_t k = 0; k < count; ++k) {
    for (int i = 0; i < 3; ++i) {
      const auto at = usize(i);
      low[at] = std::min(low[at], centre(items[k].box, i));
      high[at] = std::max(high[at], centre(items[k].box, i));
    }
  }
  int axis = 0;
  for (int i = 1; i < 3; ++i) {
    const auto at = usize(i), best = usize(axis);
    if (high[at] - low[at] > high[best] - low[best]) axis = i;
  }
  const float first = low[usize(axis)];
  const float scale = kBins / (high[usize(axis)] - first);
  if (!(scale > 0 && scale < FLT_MAX)) return count / 2;  // all in one place
  const auto bin = [&](const Item& item) {
    return std::min(static_cast<int>((centre(item.box, axis) - first) * scale), kBins - 1);
  };
  std::array<TreeBox, kBins> box;
  std::array<std::int64_t, kBins> held{};
  box.fill(empty_tree_box());
  for (std::int64_t k = 0; k < count; ++k) {
    const auto b = usize(bin(items[k]));
    ++held[b];
    grow(box[b], items[k].box);
  }
  std::array<double, kBins> right_cost{};
  TreeBox right = empty_tree_box();
  std::int64_t behind = 0;
  for (std::size_t b = kBins - 1; b > 0; --b) {
    grow(right, box[b]);
    behind += held[b];
    right_cost[b] = behind > 0 ? area(right) * static_cast<double>(behind) : 0;
  }
  TreeBox left = empty_tree_box();
  double least = std::numeric_limits<double>::infinity();
  int cut = 0;
  std::int64_t before = 0;
  for (int b = 1; b < kBins; ++b) {
    grow(left, box[usize(b - 1)]);
    before += held[usize(b - 1)];
    if (before < (count + 3) / 4 || count - before < (count + 3) / 4) continue;
    const double cost = area(left) * static_cast<double>(before) + right_cost[usize(b)];
    if (cost < least) {
      least = cost;
      cut = b;
    }
  }
  if (cut == 0) {  // no plane has a quarter on either side
    std::nth_element(items, items + count / 2, items + count, [&](const Item& p, const Item& q) {
      return centre(p.box, axis) < centre(q.box, axis);
    });
    return count / 2;
  }
  return std::partition(items, items + count, [&](const Item& item) { return bin(item) < cut; }) -
         items;
}

}  // namespace

// Parts as large as keep the nodes below well filled: `capacity` is that of a child.
TreeBox AabbTree::build(std::int32_t node, Item* items, std::int64_t count) {
  TreeBox all = empty_tree_box();
  const auto child = [&](int lane, std::int32_t value, const TreeBox& box) {
    nodes_[usize(node)].child[lane] = value;
    put(node * kWide + lane, box);
    grow(all, box);
  };
  if (count <= kWide) {
    for (int lane = 0; lane < count; ++lane) {
      place_[usize(items[lane].id)] = node * kWide + lane;
      child(lane, ~items[lane].id, items[lane].box);
    }
    return all;
  }
  std::int64_t capacity = kFill;
  while (capacity * kWide < count) capacity *= kWide;
  const std::int64_t wanted = (count + capacity - 1) / capacity;
  std::array<std::int64_t, kWide + 1> start{0, count};
  for (int parts = 1; parts < kWide; ++parts) {
    std::size_t largest = 0;
    for (std::size_t p = 1; p < usize(parts); ++p) {
      if (start[p + 1] - start[p] > start[largest + 1] - start[largest]) largest = p;
    }
    const std::int64_t size = start[largest + 1] - start[largest];
    if (parts >= wanted && (size <= kWide || size <= capacity * 4 / 3)) break;
    const std::int64_t first = split(items + start[largest], size);
    std::copy_backward(start.begin() + static_cast<std::ptrdiff_t>(largest) + 1,
                       start.begin() + parts + 1, start.begin() + parts + 2);
    start[largest + 1] = start[largest] + first;
  }
  for (int lane = 0; lane < kWide && start[usize(lane)] < count; ++lane) {
    const std::int64_t begin = start[usize(lane)];
    const std::int64_t size = start[usize(lane) + 1] - begin;
    const std::int32_t below_it = new_node(node * kWide + lane);
    const TreeBox box = build(below_it, items + begin, size);
    child(lane, below_it, box);
    area_ += area(box);
  }
  return all;
}

}  // namespace substep::rigid
