#include "substep/geometry/particle_contact.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>

#include "substep/core/interrupt.h"
#include "substep/core/lanes.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/conservative_advancement.h"
#include "substep/geometry/surely_beyond.h"

namespace substep::geometry {
namespace {

template <class Real>
void assign(Point<Real>& p, const Vec3& v) {
  p.x = static_cast<Real>(v[0]), p.y = static_cast<Real>(v[1]), p.z = static_cast<Real>(v[2]);
}
template <class Real>
double of(std::span<const Real> mass, std::int64_t i) {
  return mass[mass.size() == 1 ? 0 : usize(i)];
}

// The number next to `value` that is on its `low` or high side.
template <class Real>
Real round_up(double value) {
  const Real near = static_cast<Real>(value);
  constexpr Real kInfinity = std::numeric_limits<Real>::infinity();
  return static_cast<double>(near) < value ? std::nextafter(near, kInfinity) : near;
}

// Whether the straight way between two free points is free.
bool convex(const Collider& collider) {
  if (std::holds_alternative<Plane>(collider.shape())) return true;
  const bool closed_form = std::holds_alternative<Box>(collider.shape()) ||
                           std::holds_alternative<Sphere>(collider.shape());
  return closed_form && collider.hollow();
}

// Ball about all positions of a range.
struct Ball {
  Vec3 center;
  double radius;
};
template <class Real>
Ball ball(std::span<const Point<Real>> points) {
  using V = Vector<Real, 4 * sizeof(Real)>;
  V low = load<V>(&points[0].x), high = low;
  for (const Point<Real>& point : points) {
    const V p = load<V>(&point.x);
    low = p < low ? p : low;
    high = p > high ? p : high;
  }
  const Vec3 a(low[0], low[1], low[2]), b(high[0], high[1], high[2]);
  return {0.5 * (a + b), 0.5 * (b - a).norm()};
}

// Inside of the coordinates, `further` inside of low and high, for whole rows of points at once.
template <class Real>
class Inside {
 public:
  Inside(const Point<Real>& low, const Point<Real>& high, Real further) {
    Point<Real> lows[kPoints], highs[kPoints];
    std::fill_n(lows, kPoints, low);
    std::fill_n(highs, kPoints, high);
    low_ = load<V>(&lows[0].x) + further;
    high_ = load<V>(&highs[0].x) - further;
  }

  // visit(i) for the points of [begin, end) that are not within, and some others.
  template <class Visit>
  void for_outside(std::span<const Point<Real>> x, std::int64_t begin, std::int64_t end,
                   Visit&& visit) const {
    std::int64_t i = begin;
    for (; i + kPoints <= end; i += kPoints) {
      const V p = load<V>(&x[i].x);
      if (!any((p < low_) | (p > high_))) continue;
      for (std::int64_t k = i; k < i + kPoints; ++k) visit(k);
    }
    for (; i < end; ++i) visit(i);
  }

 private:
  static constexpr int kBytes = std::max<int>(kVectorBytes, sizeof(Point<Real>));
  static constexpr std::int64_t kPoints = kBytes / static_cast<int>(sizeof(Point<Real>));
  using V = Vector<Real, kBytes>;
  V low_, high_;
};

// The correction in the plane of motion that leads as far out of an obstacle, cut by that plane.
Vec3 in_plane(const Vec3& push) {
  if (push[2] == 0) return push;
  const Vec3 flat(push[0], push[1], 0);
  constexpr double kMost = 100;  // where it is nearly along the plane
  return flat * std::min(push.squaredNorm() / flat.squaredNorm(), kMost);
}

}  // namespace

template <class Real>
ParticleContact<Real>::ParticleContact(std::vector<Collider> obstacles, const Vec3& origin,
                                       double margin, int dimension)
    : colliders(std::move(obstacles)), origin_(origin), margin_(margin), planar_(dimension == 2) {}

template <class Real>
auto ParticleContact<Real>::pose(const Collider& collider) const -> Pose {
  return {collider.rotation(), origin_ - collider.position()};
}

// Free space as bounds of the coordinates: planes and hollow boxes along the axes.
template <class Real>
void ParticleContact<Real>::set_bounds(std::size_t c) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const Collider& collider = colliders[c];
  Obstacle& obstacle = obstacles_[c];
  Vec3 low = Vec3::Constant(-kInfinity), high = Vec3::Constant(kInfinity);
  const Vec3 at = collider.position() - origin_;
  obstacle.aligned = false;
  const BoundingBall around = bounding_ball(collider);
  obstacle.middle = obstacle.to.to_world(around.center);
  obstacle.radius = around.radius;
  obstacle.shifted = (obstacle.to.shift - obstacle.from.shift).norm();
  obstacle.turned = (obstacle.to.rotation - obstacle.from.rotation).norm();
  if (const auto* plane = std::get_if<Plane>(&collider.shape())) {
    const Vec3 normal = collider.rotation() * plane->normal;
    int axis;
    if (normal.cwiseAbs().maxCoeff(&axis) != 1 || normal.cwiseAbs().sum() != 1) return;
    (normal[axis] > 0 ? low : high)[axis] = at[axis] + normal[axis] * margin_;
  } else if (const auto* box = std::get_if<Box>(&collider.shape());
             box != nullptr && collider.hollow() && collider.rotation() == Mat3::Identity()) {
    const Vec3 room = (box->half_lengths.array() - margin_).max(0.0);
    low = at - room, high = at + room;
  } else {
    return;
  }
  if (planar_) low[2] = -kInfinity, high[2] = kInfinity;
  obstacle.aligned = true;
  const auto up = [](double v) { return round_up<Real>(v); };
  obstacle.low = {up(low[0]), up(low[1]), up(low[2]), static_cast<Real>(-kInfinity)};
  obstacle.high = {-up(-high[0]), -up(-high[1]), -up(-high[2]), static_cast<Real>(kInfinity)};
}

template <class Real>
void ParticleContact<Real>::place() {
  obstacles_.resize(colliders.size());
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    obstacles_[c].from = obstacles_[c].to = pose(colliders[c]);
    set_bounds(c);
  }
}

template <class Real>
void ParticleContact<Real>::begin_step(std::int64_t n) {
  place();
  keep_reached_ = false;
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    Obstacle& obstacle = obstacles_[c];
    obstacle.yields = colliders[c].yields();
    obstacle.parts.assign(obstacle.yields ? 2 : usize((n + kGrain - 1) / kGrain), Exchange{});
    obstacle.tracked = colliders[c].friction > 0 || colliders[c].restitution > 0;
    const std::size_t kept = obstacle.tracked ? usize(n) : 0;
    obstacle.normal.assign(kept, Point<Real>{});
    // Friction on those that yield is left to the method.
    obstacle.tangential.assign(obstacle.yields ? 0 : kept, Point<Real>{});
    obstacle.pushes.assign(usize((n + kGrain - 1) / kGrain), 0);
    keep_reached_ |= !convex(colliders[c]);
  }
  reached_.resize(keep_reached_ ? usize(n) : 0);
}

// An aligned collider: rows of points are compared with its bounds.
template <class Real>
void ParticleContact<Real>::find_near(std::size_t c, std::span<const Point<Real>> x,
                                      std::int64_t begin, std::int64_t end, double reach,
                                      std::vector<std::int32_t>& found) const {
  const Obstacle& obstacle = obstacles_[c];
  if (!obstacle.aligned) {
    find_in_ball(c, obstacle.to, x, begin, end, reach, found);
    return;
  }
  const Real further = static_cast<Real>(reach - margin_);
  const Inside<Real> bounds(obstacle.low, obstacle.high, further);
  bounds.for_outside(x, begin, end,
                     [&](std::int64_t i) { found.push_back(static_cast<std::int32_t>(i)); });
}

template <class Real>
auto ParticleContact<Real>::find_near(std::span<const Point<Real>> x, double reach) const
    -> std::vector<std::vector<Near>> {
  BoundingBalls balls;  // relative to the origin
  std::vector<std::int32_t> aligned, others;
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    const BoundingBall ball = bounding_ball(colliders[c]);
    balls.add(obstacles_[c].to.to_world(ball.center), ball.radius);
    (obstacles_[c].aligned ? aligned : others).push_back(static_cast<std::int32_t>(c));
  }
  const auto n = static_cast<std::int64_t>(x.size());
  std::vector<std::vector<Near>> found(usize((n + kGrain - 1) / kGrain));
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<Near>& near = found[usize(begin / kGrain)];
        std::vector<std::int32_t> particles;
        for (const std::int32_t c : aligned) {
          particles.clear();
          find_near(usize(c), x, begin, end, reach, particles);
          for (const std::int32_t i : particles) near.push_back({c, i});
        }
        find_among(balls, others, x, begin, end, reach, near);
        std::sort(near.begin(), near.end());
      },
      threads);
  return found;
}

// A ball about a range of particles, and those that it does not keep clear of; then parts of the
// range.
template <class Real>
void ParticleContact<Real>::find_among(const BoundingBalls& balls,
                                       std::span<const std::int32_t> around,
                                       std::span<const Point<Real>> x, std::int64_t begin,
                                       std::int64_t end, double reach,
                                       std::vector<Near>& found) const {
  constexpr std::int64_t kSingles = 8;
  if (around.empty()) return;
  const Ball all = ball(x.subspan(begin, end - begin));
  std::vector<std::int32_t> close, near;
  balls.find(all.center, all.radius + reach, close);
  std::set_intersection(around.begin(), around.end(), close.begin(), close.end(),
                        std::back_inserter(near));
  std::erase_if(near, [&](std::int32_t c) {
    const Collider& collider = colliders[usize(c)];
    const Vec3 local = obstacles_[usize(c)].to.to_local(all.center);
    return surely_beyond(collider, local, all.radius + reach) ||
           collider.local_distance(local).value > collider.lipschitz() * (all.radius + reach);
  });
  if (end - begin > kSingles) {
    const std::int64_t part = std::max<std::int64_t>((end - begin + 7) / 8, kSingles);
    for (std::int64_t b = begin; b < end; b += part) {
      find_among(balls, near, x, b, std::min(b + part, end), reach, found);
    }
    return;
  }
  for (const std::int32_t c : near) {
    const Collider& collider = colliders[usize(c)];
    for (std::int64_t i = begin; i < end; ++i) {
      const Vec3 local = obstacles_[usize(c)].to.to_local(xyz(x[i]));
      if (surely_beyond(collider, local, reach)) continue;
      if (collider.local_distance(local).value < collider.lipschitz() * reach) {
        found.push_back({c, static_cast<std::int32_t>(i)});
      }
    }
  }
}

// A ball about a range of particles that keeps clear of the collider spares them all; else parts of
// the range are looked at.
template <class Real>
void ParticleContact<Real>::find_in_ball(std::size_t c, const Pose& at,
                                         std::span<const Point<Real>> x, std::int64_t begin,
                                         std::int64_t end, double reach,
                                         std::vector<std::int32_t>& found) const {
  constexpr std::int64_t kSingles = 8;
  const Collider& collider = colliders[c];
  const double lipschitz = collider.lipschitz();
  const Ball around = ball(x.subspan(begin, end - begin));
  if (collider.local_distance(at.to_local(around.center)).value >
      lipschitz * (around.radius + reach)) {
    return;
  }
  if (end - begin > kSingles) {
    const std::int64_t part = std::max<std::int64_t>((end - begin + 7) / 8, kSingles);
    for (std::int64_t b = begin; b < end; b += part) {
      find_in_ball(c, at, x, b, std::min(b + part, end), reach, found);
    }
    return;
  }
  for (std::int64_t i = begin; i < end; ++i) {
    if (collider.local_distance(at.to_local(xyz(x[i]))).value < lipschitz * reach) {
      found.push_back(static_cast<std::int32_t>(i));
    }
  }
}

template <class Real>
bool ParticleContact<Real>::clear(std::span<Point<Real>> x, std::span<const Real> mass,
                                  std::span<Point<Real>> along) {
  std::atomic<bool> covered = false;
  BoundingBalls balls;  // relative to the origin
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    const BoundingBall ball = bounding_ball(colliders[c]);
    balls.add(obstacles_[c].from.to_world(ball.center), ball.radius);
  }
  const auto clear_range = [&](std::size_t c, std::int64_t begin, std::int64_t end) {
    const Collider& collider = colliders[c];
    const Pose &at = obstacles_[c].from, &to = obstacles_[c].to;
    std::vector<std::int32_t> found;
    if (at.shift == to.shift && at.rotation == to.rotation) {
      find_near(c, x, begin, end, margin_, found);
    } else {
      find_in_ball(c, at, x, begin, end, margin_, found);
    }
    bool any = false;
    for (const std::int32_t i : found) {
      const Vec3 local = at.to_local(xyz(x[i]));
      const double distance = collider.local_distance(local).value;
      if (of(mass, i) == 0 || !(distance < margin_)) continue;
      const bool within = distance < 0 && !std::holds_alternative<Triangle>(collider.shape());
      if (within) covered = true;
      const Vec3 out = within ? way_out(c, local) : set_off(collider, local, margin_);
      Vec3 moved = at.rotation * (out - local);
      if (planar_) moved[2] = 0;
      assign(x[i], xyz(x[i]) + moved);
      if (!along.empty()) assign(along[i], xyz(along[i]) + moved);
      any = true;
    }
    return any;
  };
  parallel_for(
      static_cast<std::int64_t>(x.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<std::int32_t> close;
        for (std::size_t next = 0; next < colliders.size();) {
          const Ball all = ball(std::span<const Point<Real>>(&x[begin], usize(end - begin)));
          balls.find(all.center, all.radius + margin_, close);
          bool moved = false;  // who is near then
          for (auto c = close.begin(); c != close.end() && !moved; ++c) {
            if (usize(*c) < next) continue;
            moved = clear_range(usize(*c), begin, end);
            next = usize(*c) + 1;
          }
          if (!moved) break;
        }
      },
      threads);
  return covered;
}

// Where a point in collider c comes out, in its frame: at the nearest place of its surface. Where
// another obstacle stands right before it, as below a block on a floor: at the nearest one along
// its axes that has more room before it.
template <class Real>
Vec3 ParticleContact<Real>::way_out(std::size_t c, const Vec3& x) const {
  constexpr double kFurther = 1.01;  // the deeper ones: no two come out at one place
  constexpr int kMostSteps = 1000;
  const double enough = 50 * margin_, far = 1e5 * margin_;
  poll_interrupt();
  const Collider& collider = colliders[c];
  const Pose& at = obstacles_[c].from;
  const auto room = [&](const Vec3& from, const Vec3& direction) {
    double free = 0;
    while (free < enough) {
      const Vec3 place = at.to_world(from + free * direction);
      double least = std::numeric_limits<double>::infinity();
      for (std::size_t other = 0; other < colliders.size(); ++other) {
        if (other == c) continue;
        const Vec3 there = obstacles_[other].from.to_local(place);
        least = std::min(
            least, colliders[other].local_distance(there).value / colliders[other].lipschitz());
      }
      if (least <= 0) break;
      free += std::max(least, margin_);
    }
    return std::min(free, enough);
  };
  const Vec3 out = set_off(collider, x, margin_) - x;
  Vec3 best = x + kFurther * out;
  double best_way = out.norm(), best_room = room(best, out.normalized());
  if (best_room >= enough) return best;
  for (int k = 0; k < 6; ++k) {
    const Vec3 direction = (k % 2 == 0 ? 1 : -1) * Vec3::Unit(k / 2);
    if (planar_ && std::abs((at.rotation * direction)[2]) > 1e-6) continue;
    double way = 0, distance = collider.local_distance(x).value;
    for (int step = 0; step < kMostSteps && distance < margin_ && way < far; ++step) {
      way += std::max(margin_ - distance, 0.1 * margin_);
      distance = collider.local_distance(x + way * direction).value;
    }
    if (!(distance >= margin_)) continue;
    const Vec3 place = x + kFurther * way * direction;
    const double there = room(place, direction);
    if (there > best_room || (there == best_room && way < best_way)) {
      best = place;
      best_way = way;
      best_room = there;
    }
  }
  return best;
}

template <class Real>
void ParticleContact<Real>::begin_substep(double h) {
  h_ = h;
  first_ = true;
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    Obstacle& obstacle = obstacles_[c];
    obstacle.from = pose(colliders[c]);
    colliders[c].advance(h);
    obstacle.to = pose(colliders[c]);
    set_bounds(c);
    std::fill(obstacle.normal.begin(), obstacle.normal.end(), Point<Real>{});
    std::fill(obstacle.tangential.begin(), obstacle.tangential.end(), Point<Real>{});
    std::fill(obstacle.pushes.begin(), obstacle.pushes.end(), 0);
  }
}

template <class Real>
void ParticleContact<Real>::project(std::span<const Point<Real>> start, std::span<Point<Real>> x,
                                    std::span<const Real> mass) {
  if (colliders.empty()) return;
  parallel_for(
      static_cast<std::int64_t>(x.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::size_t c = 0; c < colliders.size(); ++c) {
          const Obstacle& obstacle = obstacles_[c];
          if (obstacle.aligned && !obstacle.yields) clamp(c, start, x, mass, begin, end);
        }
        Ways of_chunk = ways(start, x, begin, end);
        for (std::size_t c = 0; c < colliders.size(); ++c) {
          const Obstacle& obstacle = obstacles_[c];
          if (obstacle.aligned || obstacle.yields) continue;
          if (settle_near(c, start, x, mass, begin, end, of_chunk)) {
            of_chunk = ways(start, x, begin, end);
          }
        }
        if (keep_reached_) {
          std::copy(x.begin() + begin, x.begin() + end, reached_.begin() + begin);
        }
      },
      threads);
  first_ = false;
}

// An aligned collider.
template <class Real>
void ParticleContact<Real>::clamp(std::size_t c, std::span<const Point<Real>> start,
                                  std::span<Point<Real>> x, std::span<const Real> mass,
                                  std::int64_t begin, std::int64_t end) {
  Obstacle& obstacle = obstacles_[c];
  Exchange& part = obstacle.parts[usize(begin / kGrain)];

  const auto touch = [&](std::int64_t i) {
    const double m = of(mass, i);
    if (m == 0) return;
    if (obstacle.tracked && share == 1) {
      settle(start, x, m, i);
      return;
    }
    const Point<Real> before = x[i];
    Point<Real>& p = x[i];
    p.x = std::min(std::max(p.x, obstacle.low.x), obstacle.high.x);
    p.y = std::min(std::max(p.y, obstacle.low.y), obstacle.high.y);
    p.z = std::min(std::max(p.z, obstacle.low.z), obstacle.high.z);
    const Vec3 push = xyz(p) - xyz(before);
    if (push.isZero(0)) return;
    part.add(xyz(p) + obstacle.to.shift, -m / h_ * share * push);
  };
  if (obstacle.tracked && share == 1) {
    for (std::int64_t i = begin; i < end; ++i) {
      const Point<Real>&p = x[i], &n = obstacle.normal[usize(i)];
      const Point<Real>&low = obstacle.low, &high = obstacle.high;
      if (n.x != 0 || n.y != 0 || n.z != 0 || p.x < low.x || p.y < low.y || p.z < low.z ||
          p.x > high.x || p.y > high.y || p.z > high.z) {
        touch(i);
      }
    }
    return;
  }
  Inside<Real>(obstacle.low, obstacle.high, 0).for_outside(x, begin, end, touch);
}

template <class Real>
struct ParticleContact<Real>::Ways {
  Ball before, after;
};

template <class Real>
auto ParticleContact<Real>::ways(std::span<const Point<Real>> start, std::span<const Point<Real>> x,
                                 std::int64_t begin, std::int64_t end) const -> Ways {
  const auto count = usize(end - begin);
  return {ball(std::span<const Point<Real>>(&free_before(start, begin), count)),
          ball(x.subspan(usize(begin), count))};
}

// Any other collider: a ball about a range of particles and their ways that keeps clear of it
// spares them all; else quarters of the range are looked at.
template <class Real>
bool ParticleContact<Real>::settle_near(std::size_t c, std::span<const Point<Real>> start,
                                        std::span<Point<Real>> x, std::span<const Real> mass,
                                        std::int64_t begin, std::int64_t end,
                                        const Ways& of_range) {
  constexpr std::int64_t kSingles = 8;
  const Collider& collider = colliders[c];
  const Obstacle& obstacle = obstacles_[c];
  const auto& [before, after] = of_range;
  const Vec3 center = obstacle.to.to_local(after.center);
  const Vec3 came = pose_before(obstacle).to_local(before.center);
  const double radius = std::max(after.radius, before.radius + (came - center).norm());
  const double reach = collider.lipschitz() * radius + margin_;
  if (collider.local_distance(center).value > reach) {
    // Beyond the margin friction has to do with those only that add_push() was told of.
    const auto pushed = [](const Point<Real>& n) { return n.x != 0 || n.y != 0 || n.z != 0; };
    const auto normals = obstacle.normal.begin();
    if (!obstacle.tracked || share != 1 || obstacle.pushes[usize(begin / kGrain)] == 0 ||
        std::none_of(normals + begin, normals + end, pushed)) {
      return false;
    }
  }
  bool moved = false;
  if (end - begin > kSingles) {
    const std::int64_t quarter = (end - begin + 3) / 4;
    for (std::int64_t b = begin; b < end; b += quarter) {
      const std::int64_t e = std::min(b + quarter, end);
      moved |= settle_near(c, start, x, mass, b, e, ways(start, x, b, e));
    }
    return moved;
  }
  for (std::int64_t i = begin; i < end; ++i) {
    const double m = of(mass, i);
    if (m != 0) moved |= settle(start, x, m, i);
  }
  return moved;
}

// One particle and all colliders, in turn until none moves it any more.
template <class Real>
bool ParticleContact<Real>::settle(std::span<const Point<Real>> start, std::span<Point<Real>> x,
                                   double mass, std::int64_t i) {
  constexpr int kRounds = 4;
  constexpr double kClear = 1.001;  // and more than rounds
  const Vec3 began = xyz(start[i]), from = xyz(free_before(start, i));
  Vec3 at = xyz(x[i]);
  if (!at.allFinite()) return false;  // the method's own check finds it
  // What rounds away, or else would be an impulse in every step on what rests.
  const double least =
      std::max(1e-9 * margin_, static_cast<double>(2 * std::numeric_limits<Real>::epsilon()) *
                                   at.cwiseAbs().maxCoeff());
  bool moved = false;
  for (int round = 0; round < kRounds; ++round) {
    bool changed = false;
    for (std::size_t c = 0; c < colliders.size(); ++c) {
      Obstacle& obstacle = obstacles_[c];
      if (obstacle.yields) continue;
      if (!obstacle.tracked || obstacle.pushes[usize(i / kGrain)] == 0) {
        // No way in the frame of the obstacle is longer than this one.
        const double way = (at - from).norm() + obstacle.shifted +
                           obstacle.turned * (from + obstacle.from.shift).norm();
        const double away = (at - obstacle.middle).norm() - obstacle.radius;
        if (away > kClear * std::max(margin_, way)) continue;
      }
      const Vec3 target = obstacle.to.to_local(at);
      const Vec3 came = pose_before(obstacle).to_local(from);
      Vec3 p = advance_freely(colliders[c], came, target, margin_);
      if (obstacle.tracked && share == 1) {
        Vec3 normal = p - target;
        const Vec3 out = obstacle.to.rotation * normal;
        if (planar_ && out[2] != 0) {
          normal = obstacle.to.rotation.transpose() * in_plane(out);
          p = target + normal;
        }
        p = rub(c, i, obstacle.from.to_local(began), p, normal);
      }
      Vec3 push = obstacle.to.rotation * (p - target);
      if (planar_) push = in_plane(push);
      if (!(push.squaredNorm() > least * least)) continue;
      changed = true;
      at += push;
      obstacle.parts[usize(i / kGrain)].add(at + obstacle.to.shift, -mass / h_ * share * push);
    }
    if (!changed) break;
    moved = true;
  }
  if (moved) assign(x[i], at);
  return moved;
}

// Friction on a particle that came from `start` to p, `push` of which the normal did; all in the
// frame of collider c. Returns where it ends.
template <class Real>
Vec3 ParticleContact<Real>::rub(std::size_t c, std::int64_t i, const Vec3& start, const Vec3& p,
                                const Vec3& push) {
  Obstacle& obstacle = obstacles_[c];
  Point<Real>& kept_normal = obstacle.normal[usize(i)];
  Point<Real>& kept_tangential = obstacle.tangential[usize(i)];
  const Vec3 N = xyz(kept_normal) + push, T = xyz(kept_tangential);
  const double size = N.norm(), friction = colliders[c].friction;
  assign(kept_normal, N);
  if (size > 0) obstacle.pushes[usize(i / kGrain)] = 1;
  if (size == 0 || friction == 0) return p;
  const Vec3 n = N / size, way = p - start;
  Vec3 wanted = T - (way - n.dot(way) * n);
  wanted -= n.dot(wanted) * n;
  if (const double length = wanted.norm(); length > friction * size) {
    wanted *= friction * size / length;
  }
  const Vec3 target = p + (wanted - T);
  assign(kept_tangential, wanted);
  return advance_freely(colliders[c], p, target, margin_);
}

template <class Real>
void ParticleContact<Real>::slide(std::span<const Point<Real>> x, std::span<Point<Real>> v,
                                  std::span<const Real> mass) {
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    const Collider& collider = colliders[c];
    Obstacle& obstacle = obstacles_[c];
    if (collider.friction == 0 || obstacle.yields) continue;
    const auto rub = [&](std::int64_t i) {
      const Vec3 N = xyz(obstacle.normal[usize(i)]);
      const double size = N.norm();
      if (size == 0) return;
      const Vec3 n = obstacle.to.rotation * (N / size),
                 T = obstacle.to.rotation * xyz(obstacle.tangential[usize(i)]);
      const Vec3 arm = xyz(x[usize(i)]) + obstacle.to.shift;
      const Vec3 surface = collider.velocity + collider.angular_velocity.cross(arm);
      Vec3 way = h_ * (xyz(v[i]) - surface);
      Vec3 wanted = T - (way - n.dot(way) * n);
      if (const double length = wanted.norm(); length > collider.friction * size) {
        wanted *= collider.friction * size / length;
      }
      const Vec3 dv = (wanted - T) / h_;
      assign(v[i], xyz(v[i]) + dv);
      obstacle.parts[usize(i / kGrain)].add(arm, -of(mass, i) * dv);
    };
    parallel_for(
        static_cast<std::int64_t>(v.size()), kGrain,
        [&](std::int64_t begin, std::int64_t end) {
          for (std::int64_t i = begin; i < end; ++i) rub(i);
        },
        threads);
  }
}

template <class Real>
void ParticleContact<Real>::bounce(std::span<const Point<Real>> start,
                                   std::span<const Point<Real>> v_start, std::span<Point<Real>> v,
                                   std::span<const Real> mass) {
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    const Collider& collider = colliders[c];
    Obstacle& obstacle = obstacles_[c];
    if (collider.restitution == 0 || obstacle.yields) continue;
    const auto strike = [&](std::int64_t i) {
      const Vec3 N = xyz(obstacle.normal[usize(i)]);
      const double size = N.norm();
      if (size == 0) return;
      const Vec3 n = obstacle.to.rotation * (N / size);
      const Vec3 local = obstacle.from.to_local(xyz(start[i]));
      const Vec3 arm = obstacle.to.rotation * local;
      const Vec3 surface = collider.velocity + collider.angular_velocity.cross(arm);
      const SignedDistance there = collider.local_distance(local);
      double gap = std::max(there.value - margin_, 0.0);
      if (planar_) gap /= std::max(n.dot(obstacle.to.rotation * there.gradient), 0.1);
      const double before = -n.dot(xyz(v_start[i]) - surface);
      const double unhindered = (gap + size) / h_;  // the approach, had there been no obstacle
      const double gained = unhindered - before;    // by the acceleration during the substep
      if (before <= 2 * std::abs(gained)) return;   // pressed on rather than hit
      // Semi-implicit Euler keeps (v - a h / 2)^2 / 2 - a x: that is the energy which the gap adds
      // to, and of which restitution^2 remains.
      const double middle = before + 0.5 * gained;
      const double impact = std::sqrt(std::max(middle * middle + 2 * gained * gap / h_, 0.0));
      const double lacking =
          collider.restitution * impact + 0.5 * gained - n.dot(xyz(v[i]) - surface);
      if (!(lacking > 0)) return;
      assign(v[i], xyz(v[i]) + lacking * n);
      obstacle.parts[usize(i / kGrain)].add(arm, -of(mass, i) * lacking * n);
    };
    parallel_for(
        static_cast<std::int64_t>(v.size()), kGrain,
        [&](std::int64_t begin, std::int64_t end) {
          for (std::int64_t i = begin; i < end; ++i) strike(i);
        },
        threads);
  }
}

template <class Real>
void ParticleContact<Real>::end_step() {
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    Exchange sum;
    for (const Exchange& part : obstacles_[c].parts) sum += part;
    colliders[c].set_exchange(sum);
  }
}

template <class Real>
void ParticleContact<Real>::add_push(std::size_t c, std::int64_t i, const Point<Real>& x,
                                     const Vec3& push, double mass) {
  Obstacle& obstacle = obstacles_[c];
  const std::size_t part = obstacle.yields ? 0 : usize(i / kGrain);
  obstacle.parts[part].add(xyz(x) + obstacle.to.shift, -mass / h_ * push);
  if (!obstacle.tracked) return;
  obstacle.pushes[usize(i / kGrain)] = 1;
  Point<Real>& normal = obstacle.normal[usize(i)];
  assign(normal, xyz(normal) + obstacle.to.rotation.transpose() * push);
}

template <class Real>
Vec3 ParticleContact<Real>::way_off(std::size_t c, const Point<Real>& start,
                                    const Point<Real>& x) const {
  const Obstacle& obstacle = obstacles_[c];
  const Vec3 at = xyz(x);
  if (!at.allFinite()) return Vec3::Zero();  // the method's own check finds it
  const Vec3 target = obstacle.to.to_local(at);
  const Vec3 free =
      advance_freely(colliders[c], obstacle.from.to_local(xyz(start)), target, margin_);
  const Vec3 push = obstacle.to.rotation * (free - target);
  return planar_ ? in_plane(push) : push;
}

template <class Real>
Vec3 ParticleContact<Real>::pushed(std::size_t c, std::int64_t i) const {
  return obstacles_[c].to.rotation * xyz(obstacles_[c].normal[usize(i)]);
}

template <class Real>
void ParticleContact<Real>::add_impulse(std::size_t c, const Point<Real>& x, const Vec3& impulse) {
  obstacles_[c].parts[0].add(xyz(x) + obstacles_[c].to.shift, impulse);
}

template <class Real>
Exchange ParticleContact<Real>::take(std::size_t c) {
  std::vector<Exchange>& parts = obstacles_[c].parts;
  parts[1] += parts[0];
  return std::exchange(parts[0], Exchange{});
}

template <class Real>
void ParticleContact<Real>::moved(std::size_t c) {
  Obstacle& obstacle = obstacles_[c];
  const Vec3 before = obstacle.to.shift;
  obstacle.to = pose(colliders[c]);
  for (Exchange& part : obstacle.parts) {  // about the position, which is another one
    part.torque += (obstacle.to.shift - before).cross(part.impulse);
  }
}

template class ParticleContact<float>;
template class ParticleContact<double>;

}  // namespace substep::geometry
