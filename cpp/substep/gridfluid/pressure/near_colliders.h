// Which of many obstacles may be nearest around a point.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <variant>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/geometry/surely_beyond.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

// Whether what pushes a collider moves it: it yields, and its body has a mobility.
inline bool responds(const geometry::Collider& collider) {
  return collider.yields() && !collider.body.mobility.isZero(0);
}

// A collider that is a ball, in as little memory as its distance takes: of many, most time goes
// into that.
struct Ball {
  geometry::Vec3 middle = geometry::Vec3::Zero();
  double radius = 0;
  double sign = 0;  // -1 where it is hollow; 0: the collider is no ball
};
inline Ball ball_of(const geometry::Collider& collider) {
  const auto* const ball = std::get_if<geometry::Sphere>(&collider.shape());
  if (!ball) return {};
  return {collider.position(), ball->radius, collider.hollow() ? -1.0 : 1.0};
}

// The value of its signed_distance() alone, which takes half the time; infinity for a facet that is
// surely further than `most`.
inline double signed_distance_of(const geometry::Collider& collider, const geometry::Vec3& x,
                                 double most) {
  const geometry::Vec3 local = collider.rotation().transpose() * (x - collider.position());
  if (geometry::surely_beyond(collider, local, most))
    return std::numeric_limits<double>::infinity();
  return collider.local_distance(local).value;
}

// A collider, and its signed distance from a point [m].
struct NearCollider {
  double distance;
  std::size_t collider;

  auto operator<=>(const NearCollider&) const = default;
};

// Those that may be nearest around a point, the nearest to it first, with their distances from it.
struct NearColliders {
  geometry::Vec3 point = geometry::Vec3::Zero();
  std::vector<NearCollider> all;
};

// Blocks of so many nodes of a grid along each axis; the last ones have fewer.
template <int D>
struct Blocks {
  Blocks(const Layout<D>& layout, int size_) : size(size_) {
    for (std::size_t a = 0; a < D; ++a) along[a] = layout.cells[a] / size + 1;
  }
  std::int64_t count() const {
    std::int64_t n = 1;
    for (const int of_axis : along) n *= of_axis;
    return n;
  }
  std::int64_t of(const std::array<int, D>& node) const {
    std::int64_t block = 0;
    for (std::size_t a = 0; a < D; ++a) block = block * along[a] + node[a] / size;
    return block;
  }
  std::array<int, D> first(std::int64_t block) const {  // node
    std::array<int, D> node;
    for (std::size_t a = D; a-- > 0; block /= along[a])
      node[a] = static_cast<int>(block % along[a]) * size;
    return node;
  }

  int size;
  std::array<int, D> along;
};

class NearestColliders {
 public:
  // balls: ball_of() of all; lipschitz: of all signed distances.
  NearestColliders(std::span<const geometry::Collider> colliders, std::span<const Ball> balls,
                   double lipschitz)
      : colliders_(colliders), balls_(balls), lipschitz_(lipschitz) {}

  // The nearest to x, the first where there are several.
  NearCollider nearest(const NearColliders& around, const geometry::Vec3& x) const {
    NearCollider found{std::numeric_limits<double>::infinity(), 0};
    for_near(around, x, [&](const NearCollider& next) {
      found = std::min(found, next);
      return found.distance;
    });
    return found;
  }
  // Those of `around` that may be nearest to what is not further from x than `reach`.
  void find_nearby(const NearColliders& around, const geometry::Vec3& x, double reach,
                   NearColliders& found) const {
    found.point = x;
    found.all.clear();
    double most = std::numeric_limits<double>::infinity();
    for_near(around, x, [&](const NearCollider& next) {
      most = std::min(most, next.distance + kRounding * 2 * lipschitz_ * reach);
      found.all.push_back(next);
      return most;
    });
    std::erase_if(found.all, [&](const NearCollider& one) { return one.distance > most; });
    if (!found.all.empty())
      std::iter_swap(found.all.begin(), std::min_element(found.all.begin(), found.all.end()));
  }

 private:
  static constexpr double kRounding = 1.01;  // and more

  // use(collider) with the distance from x, for all that are not further than it returns.
  template <class Use>
  void for_near(const NearColliders& around, const geometry::Vec3& x, const Use& use) const {
    double moved = 0, most = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < around.all.size(); ++k) {
      const auto& [distance, collider] = around.all[k];
      if (k == 1) moved = kRounding * lipschitz_ * (x - around.point).norm();
      if (distance - moved > most) continue;
      const Ball& ball = balls_[collider];
      const double here = ball.sign == 0 ? signed_distance_of(colliders_[collider], x, most)
                                         : ball.sign * ((x - ball.middle).norm() - ball.radius);
      if (here <= most) most = use(NearCollider{here, collider});
    }
  }

  std::span<const geometry::Collider> colliders_;
  std::span<const Ball> balls_;
  double lipschitz_;
};

}  // namespace substep::gridfluid
