#include "substep/gridfluid/pressure/obstacles.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <utility>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/pressure/revolution.h"

namespace substep::gridfluid {
namespace {

using geometry::Collider;

constexpr double kBand = 2;  // cells around the surface where distances are exact
constexpr int kPose = 7;     // numbers of a collider's state that say where it is

// The hat function over what is open is the mean, over a cell, of what is open of a cell around
// each of its points: clamp(distance + 1/2) where the surface is flat. By the rule of trapezoids,
// with halves along each axis, of the distances at its corners. Sides are mirrors.
template <class Real, std::size_t kCorners>
Real mean_open(const std::array<Real, kCorners>& d) {
  if constexpr (kCorners == 1) {
    return std::clamp(d[0] + Real(0.5), Real(0), Real(1));
  } else {
    std::array<Real, kCorners / 2> lower, middle, upper;
    for (std::size_t k = 0; k < lower.size(); ++k) {
      lower[k] = d[k];
      upper[k] = d[lower.size() + k];
      middle[k] = (lower[k] + upper[k]) / 2;
    }
    return (mean_open(lower) + 2 * mean_open(middle) + mean_open(upper)) / 4;
  }
}

}  // namespace

template <class Real, int D>
Obstacles<Real, D>::Obstacles(const Layout<D>& layout, const Vec3& low_, double dx_,
                              std::vector<Collider> obstacles, bool around)
    : colliders(std::move(obstacles)),
      low(low_),
      dx(dx_),
      layout_(layout),
      around_(around),
      small_(layout, kSmall) {}

template <class Real, int D>
void Obstacles<Real, D>::find_distance(int threads) {
  if (!any()) return;
  std::vector<std::array<double, Collider::kStateSize>> states;
  std::vector<Vec3> corners;
  std::vector<bool> yield;
  moving_ = false;
  for (const Collider& c : colliders) {
    states.push_back(c.state());
    if (const auto* facet = std::get_if<geometry::Triangle>(&c.shape()))
      corners.insert(corners.end(), {facet->a, facet->b, facet->c});
    yield.push_back(responds(c));
    moving_ |= !c.velocity.isZero(0) || !c.angular_velocity.isZero(0);
  }
  const auto in_place = [](const auto& was, const auto& is) {
    return std::equal(is.begin(), is.begin() + kPose, was.begin());
  };
  if (!found_ || corners != corners_ ||
      !std::equal(states.begin(), states.end(), states_.begin(), states_.end(), in_place)) {
    found_ = know_open_ = know_near_ = false;
    find_distances(threads);
    found_ = true;
  }
  if (yield != yield_) know_near_ = false;
  if (states != states_) know_velocity_ = false;
  states_ = std::move(states);
  corners_ = std::move(corners);
  yield_ = std::move(yield);
}

template <class Real, int D>
void Obstacles<Real, D>::find(int threads) {
  if (!any()) return;
  find_distance(threads);
  if (!know_open_) {
    find_open(threads);
    find_room(threads);
    know_open_ = true;
    know_cuts_ = false;
  }
  const bool yield = std::find(yield_.begin(), yield_.end(), true) != yield_.end();
  if ((moving_ || yield) && !know_near_) {
    find_faces_near(threads);
    know_near_ = true;
    know_velocity_ = false;
  }
  if (moving_ && !know_velocity_) {
    find_velocities(threads);
    know_velocity_ = true;
  }
}

// Of a point in cells.
template <class Real, int D>
Vec3 Obstacles<Real, D>::world(const std::array<double, D>& x) const {
  Vec3 at = low;
  for (std::size_t a = 0; a < D; ++a) at[static_cast<int>(a)] += dx * x[a];
  return at;
}

template <class Real, int D>
Vec3 Obstacles<Real, D>::middle(std::int64_t i, int faces_of) const {
  return middle_of(layout_.cell(i), faces_of);
}

template <class Real, int D>
Vec3 Obstacles<Real, D>::middle_of(const std::array<int, D>& cell, int faces_of) const {
  std::array<double, D> x;
  for (std::size_t a = 0; a < D; ++a) x[a] = cell[a] + (static_cast<int>(a) == faces_of ? 0 : 0.5);
  return world(x);
}

template <class Real, int D>
std::size_t Obstacles<Real, D>::nearest(const Vec3& x) const {
  std::array<int, D> node;
  for (std::size_t a = 0; a < D; ++a) {
    const double at = std::floor((x[int(a)] - low[int(a)]) / dx);
    node[a] = static_cast<int>(std::clamp(at, 0.0, double(layout_.cells[a])));
  }
  return nearest_of(near_block(node), x);
}

template <class Real, int D>
std::size_t Obstacles<Real, D>::nearest_of(const NearColliders& near, const Vec3& x) const {
  return near.all.size() == 1 ? near.all[0].collider : find_nearest().nearest(near, x).collider;
}

// The signed distance of a point, in cells.
template <class Real, int D>
Real Obstacles<Real, D>::distance_at(const NearColliders& near,
                                     const std::array<double, D>& x) const {
  const NearCollider nearest = find_nearest().nearest(near, world(x));
  const Real distance(nearest.distance / dx);
  if (std::abs(distance) >= kTouching) return distance;
  return std::min(below_flat(near, x, colliders[nearest.collider]), std::min(distance, Real(0)));
}

// What lies flat on a side of the box has no fluid below, and is in the box as if it went on
// beyond: a point of the side there is as deep in it as the one half a cell above.
template <class Real, int D>
Real Obstacles<Real, D>::below_flat(const NearColliders& near, const std::array<double, D>& x,
                                    const Collider& collider) const {
  constexpr double kLies = 0.99;  // of the normal along an axis
  const Vec3 at = world(x), normal = collider.signed_distance(at).gradient;
  std::array<double, D> above = x;
  bool lies = false;
  for (std::size_t a = 0; a < D; ++a) {
    if (layout_.periodic[a] || (x[a] > 0 && x[a] < layout_.cells[a])) continue;
    above[a] += x[a] > 0 ? -0.5 : 0.5;
    lies = lies || std::abs(normal[static_cast<int>(a)]) > kLies;
  }
  if (!lies || !is_flat(collider, at)) return 0;
  return Real(find_nearest().nearest(near, world(above)).distance / dx);
}

template <class Real, int D>
bool Obstacles<Real, D>::is_flat(const Collider& collider, const Vec3& x) const {
  constexpr double kFlat = 0.01;  // sum of curvatures [1/cell]
  return std::abs(collider.hessian(x).trace()) * dx < kFlat;
}

// Those that may be nearest to what is beside a node, its cell and the faces of that among it.
template <class Real, int D>
const NearColliders& Obstacles<Real, D>::near_block(const std::array<int, D>& node) const {
  const NearColliders& near = of_small_[usize(small_.of(node))];
  return near.all.empty() ? all_ : near;
}

// Those of `around` that may be nearest to the cells that begin in a block.
template <class Real, int D>
void Obstacles<Real, D>::find_near(const NearColliders& around, const Blocks<D>& blocks,
                                   std::int64_t block, NearColliders& found) const {
  std::array<double, D> middle;
  for (std::size_t a = 0; a < D; ++a) middle[a] = blocks.first(block)[a] + blocks.size / 2.0;
  find_nearest().find_nearby(around, world(middle), std::sqrt(D) * blocks.size / 2 * dx, found);
}

// In blocks of nodes: where the middle is far from all surfaces, all of a block is. Those that may
// be nearest are found for the widest blocks, of these for blocks half as wide, and so on.
template <class Real, int D>
void Obstacles<Real, D>::find_distances(int threads) {
  if (distance_.size() == 0) assign(distance_, layout_.size, Real(0));
  lipschitz_ = 1;
  balls_.clear();
  for (const Collider& c : colliders) {
    lipschitz_ = std::max(lipschitz_, c.lipschitz());
    balls_.push_back(ball_of(c));
  }
  all_.all.clear();
  for (std::size_t c = 0; c < colliders.size(); ++c)
    all_.all.push_back({-std::numeric_limits<double>::infinity(), c});
  using Nearby = std::vector<NearColliders>;
  const auto narrow = [&](const Blocks<D>& to, const auto& around) {
    Nearby found(usize(to.count()));
    for_numbers(
        to.count(), threads,
        [&](std::size_t b) {
          const auto block = static_cast<std::int64_t>(b);
          find_near(around(to.first(block)), to, block, found[b]);
        },
        1);
    return found;
  };
  const Blocks<D> widest(layout_, 2 * kWide), wide(layout_, kWide), blocks(layout_, kBlock);
  const Nearby of_widest = narrow(widest, [&](const auto&) -> const auto& { return all_; });
  const Nearby of_wide = narrow(wide, [&](const std::array<int, D>& node) -> const auto& {
    return of_widest[usize(widest.of(node))];
  });
  of_small_.resize(usize(small_.count()));
  parallel_for(
      blocks.count(), 32,
      [&](std::int64_t begin, std::int64_t end) {
        NearColliders around;
        for (std::int64_t block = begin; block < end; ++block)
          find_distances_in(of_wide[usize(wide.of(blocks.first(block)))], blocks, block, around);
      },
      threads);
}

// In one of the blocks, of those that are `nearby`; `around` is room for those that it finds.
template <class Real, int D>
void Obstacles<Real, D>::find_distances_in(const NearColliders& nearby, const Blocks<D>& blocks,
                                           std::int64_t number, NearColliders& around) {
  const std::array<int, D> first = blocks.first(number);
  std::array<double, D> middle;
  for (std::size_t a = 0; a < D; ++a) middle[a] = first[a] + (kBlock - 1) / 2.0;
  double there = find_nearest().nearest(nearby, world(middle)).distance / dx;
  const auto is_far = [&](double reach) {
    return std::abs(there) > std::sqrt(D) * reach * lipschitz_ + kBand;
  };
  const bool all_far = is_far((kBlock - 1) / 2.0);
  if (!all_far) find_near(nearby, blocks, number, around);
  std::array<int, D> end, from, to, node;
  for (std::size_t a = 0; a < D; ++a) end[a] = std::min(first[a] + kBlock, layout_.cells[a] + 1);
  for (std::size_t part = 0; part < 1 << D; ++part) {
    for (std::size_t a = 0; a < D; ++a) {
      from[a] = first[a] + (part >> a & 1) * kSmall;
      to[a] = std::min(from[a] + kSmall, end[a]);
    }
    if (!std::equal(from.begin(), from.end(), end.begin(), std::less())) continue;
    const std::int64_t block = small_.of(from);
    NearColliders& near = of_small_[usize(block)];
    near.all.clear();
    if (!all_far) {
      find_near(around, small_, block, near);
      there = near.all.front().distance / dx;
    }
    const bool far = all_far || is_far(kSmall / 2.0);
    node = from;
    do {
      std::array<double, D> x;
      std::copy(node.begin(), node.end(), x.begin());
      distance_[usize(layout_.index(node))] = far ? Real(there) : distance_at(near, x);
    } while (next_in_block(node, from, to));
  }
}

template <class Real, int D>
void Obstacles<Real, D>::find_faces_near(int threads) {
  using Faces = std::vector<Face>;
  for (std::size_t a = 0; a < D; ++a) {
    const std::span<const Real> open = of(open_, static_cast<int>(a));
    for (Fields* const field : {&velocity_, &displacing_})  // what the last faces have
      if ((*field)[a].size() > 0)
        for (const Face& face : near_[a]) (*field)[a][usize(face.index)] = 0;
    near_[a] = gather_rows(
        layout_, all_faces(layout_, a), threads, Faces{},
        [&](std::int64_t begin, std::int64_t end) {
          Faces found;
          std::array<int, D> cell = layout_.cell(begin);
          for (std::int64_t i = begin; i < end; ++i, ++cell[D - 1]) {
            if (std::abs(distance_[usize(i)]) > Real(kBand)) continue;
            if (!around_ && open[usize(i)] == 1) continue;
            const Vec3 at = middle_of(cell, static_cast<int>(a));
            found.push_back({i, nearest_of(near_block(cell), at)});
          }
          return found;
        },
        [](Faces& all, const Faces& part) { all.insert(all.end(), part.begin(), part.end()); });
  }
}

template <class Real, int D>
void Obstacles<Real, D>::find_velocities(int threads) {
  std::vector<Vec3> turns;  // that displace fluid
  rolling_ = false;
  for (const Collider& c : colliders) {
    turns.push_back(turns_of_pressure<D>(c) * c.angular_velocity);
    rolling_ = rolling_ || turns.back() != c.angular_velocity;
  }
  for (std::size_t a = 0; a < D; ++a) {
    const int axis = static_cast<int>(a);
    if (velocity_[a].size() == 0) assign(velocity_[a], layout_.size, Real(0));
    if (rolling_ && displacing_[a].size() == 0) assign(displacing_[a], layout_.size, Real(0));
    for_numbers(static_cast<std::int64_t>(near_[a].size()), threads, [&](std::size_t k) {
      const auto [i, c] = near_[a][k];
      const Collider& collider = colliders[c];
      const Vec3 at = middle(i, axis);
      velocity_[a][usize(i)] = Real(collider.surface_velocity(at)[axis]);
      if (!rolling_) return;
      const Vec3 v = collider.velocity + turns[c].cross(at - collider.position());
      displacing_[a][usize(i)] = Real(v[axis]);
    });
  }
}

template <class Real, int D>
void Obstacles<Real, D>::find_room(int threads) {
  constexpr Real kMost = 1.5;  // of the middle of a cell with a corner nearer than 1/2
  if (room_.size() == 0) assign(room_, layout_.size, Real(1));
  std::array<std::size_t, D> axes;
  std::iota(axes.begin(), axes.end(), std::size_t{0});
  for_rows(layout_, all_cells(layout_), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const Real distance = at_centre(i);
      const bool far = std::abs(distance) >= kMost;
      room_[usize(i)] = far ? Real(distance > 0) : mean_open(at_corners(i, axes));
    }
  });
}

template <class Real, int D>
Real Obstacles<Real, D>::at_centre(std::int64_t i) const {
  const std::array<std::int64_t, D>& s = layout_.stride;
  const auto edge = [&](std::int64_t j) { return distance_[usize(j)] + distance_[usize(j + 1)]; };
  if constexpr (D == 2) {
    return (edge(i) + edge(i + s[0])) / 4;
  } else {
    return (edge(i) + edge(i + s[0]) + edge(i + s[1]) + edge(i + s[0] + s[1])) / 8;
  }
}

template <class Real, int D>
Real Obstacles<Real, D>::at_face(std::int64_t i, std::size_t axis) const {
  const std::int64_t b = layout_.stride[(axis + 1) % D];
  const Real low = distance_[usize(i)] + distance_[usize(i + b)];
  if constexpr (D == 2) {
    return low / 2;
  } else {
    const std::int64_t c = i + layout_.stride[(axis + 2) % D];
    return (low + (distance_[usize(c)] + distance_[usize(c + b)])) / 4;
  }
}

// The faces and the surface close the part of a cell that is open: their normals add up to 0.
template <class Real, int D>
std::array<Real, D> Obstacles<Real, D>::surface(std::int64_t i) const {
  std::array<Real, D> area;
  for (std::size_t a = 0; a < D; ++a) {
    area[a] = open_[a][usize(i)] - open_[a][usize(i + layout_.stride[a])];
  }
  return area;
}

template class Obstacles<float, 2>;
template class Obstacles<float, 3>;
template class Obstacles<double, 2>;
template class Obstacles<double, 3>;

}  // namespace substep::gridfluid
