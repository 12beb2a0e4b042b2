// Balls about obstacles: which of many may be near to a point, without asking each for its
// distance. They lie side by side, so that a vector of them takes a comparison.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "substep/core/lanes.h"
#include "substep/core/usize.h"
#include "substep/geometry/bounding_ball.h"

namespace substep::geometry {

// One of a collider, where it is now: to ask for many points.
class PlacedBall {
 public:
  explicit PlacedBall(const Collider& collider) {
    const BoundingBall ball = bounding_ball(collider);
    if (!std::isfinite(ball.radius)) return;
    center_ = collider.position() + collider.rotation() * ball.center;
    radius_ = ball.radius + kOfLength * ball.radius + kOfPlace * center_.cwiseAbs().maxCoeff();
  }
  // Whether the signed distance at x is above `reach` [m], whatever rounds.
  bool beyond(const Vec3& x, double reach) const {
    const double r = radius_ + reach + kOfLength * std::abs(reach);
    return r < 0 || (x - center_).squaredNorm() > r * r;
  }

  // Rounding must not decide who is near: of lengths, and of distances from the origin.
  static constexpr double kOfLength = 1e-9, kOfPlace = 1e-12;

 private:
  Vec3 center_ = Vec3::Zero();
  double radius_ = std::numeric_limits<double>::infinity();
};

class BoundingBalls {
 public:
  void clear() {
    for (auto* numbers : {&x_, &y_, &z_, &radius_}) numbers->clear();
    size_ = 0;
  }
  std::int32_t size() const { return size_; }

  // One more, in the world.
  void add(const Vec3& center, double radius) {
    if (size_ % kMany == 0) {  // room for a vector of balls that nothing is near to
      for (auto* numbers : {&x_, &y_, &z_}) numbers->resize(usize(size_ + kMany));
      radius_.resize(usize(size_ + kMany), -std::numeric_limits<double>::infinity());
    }
    const Vec3 at = std::isfinite(radius) ? center : Vec3(Vec3::Zero());
    const auto k = usize(size_++);
    x_[k] = at.x(), y_[k] = at.y(), z_[k] = at.z();
    radius_[k] = radius + kOfLength * radius + kOfPlace * at.cwiseAbs().maxCoeff();
  }
  // That of a collider, where it is now, and `further` around it.
  void add(const Collider& collider, double further = 0) {
    const BoundingBall ball = bounding_ball(collider);
    add(collider.position() + collider.rotation() * ball.center, ball.radius + further);
  }

  // Writes into `found` the numbers, ascending, of those that may have a signed distance of at most
  // `reach` [m] at x: all that have, whatever rounds, and few others.
  void find(const Vec3& x, double reach, std::vector<std::int32_t>& found) const {
    found.clear();
    const double wide = reach + kOfLength * std::abs(reach);
    for (std::int32_t k = 0; k < size_; k += kMany) {
      const auto at = usize(k);
      const V dx = load<V>(&x_[at]) - x.x(), dy = load<V>(&y_[at]) - x.y(),
              dz = load<V>(&z_[at]) - x.z(), r = load<V>(&radius_[at]) + wide;
      const auto near = ~(dx * dx + dy * dy + dz * dz > r * r) & ~(r < 0);  // NaN is near to all
      if (!any(near)) continue;
      for (std::int32_t lane = 0; lane < std::min(kMany, size_ - k); ++lane) {
        if (near[lane] != 0) found.push_back(k + lane);
      }
    }
  }

 private:
  using V = Vector<double>;
  static constexpr std::int32_t kMany = kVectorBytes / static_cast<int>(sizeof(double));
  static constexpr double kOfLength = PlacedBall::kOfLength, kOfPlace = PlacedBall::kOfPlace;

  std::vector<double> x_, y_, z_, radius_;
  std::int32_t size_ = 0;
};

}  // namespace substep::geometry
