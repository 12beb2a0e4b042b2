#include "substep/mpm/boundary/particle_boundary.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/lanes.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/surely_beyond.h"

namespace substep::mpm {
namespace {

using geometry::Collider;
using geometry::Exchange;
using geometry::Sphere;
using geometry::Vec3;

Vec3 to_local(const Collider& collider, const Vec3& x) {
  return collider.rotation().transpose() * (x - collider.position());
}
bool moves(const Collider& collider) {
  return !collider.velocity.isZero(0) || !collider.angular_velocity.isZero(0);
}
// All that begin_step depends on: position, orientation, velocity, angular velocity, and the shape.
bool same_motion(const Collider& a, const Collider& b) {
  constexpr std::size_t kMotion = 13;
  const auto p = a.state(), q = b.state();
  return std::equal(p.begin(), p.begin() + kMotion, q.begin()) && a.shapes() == b.shapes();
}

}  // namespace

template <class Real, int D>
Vec3 ParticleBoundary<Real, D>::first_node(std::uint64_t key) const {
  const auto block = transfer::BlockKey<D>::unpack(key);
  Vec3 x = Vec3::Zero();
  for (int d = 0; d < D; ++d) {
    x[d] = cell_ * (static_cast<double>(transfer::kBlock) * block[usize(d)]);
  }
  return x;
}

template <class Real, int D>
Vec3 ParticleBoundary<Real, D>::middle_of(const Vec3& first) const {
  Vec3 middle = first;
  middle.template head<D>().array() += kHalf * cell_;
  return middle;
}

// Balls about the surfaces, for find() within an arena and the margin: with the way of this step.
// With a the distance of the middle of an arena of radius r from the centre of a ball of radius R,
// which is o from the collider's position, comes_near() is true only where
//   a - R <= r + margin + dt |v| + dt |w| (a + o + r + dt |v|).
template <class Real, int D>
geometry::BoundingBalls ParticleBoundary<Real, D>::balls_with_ways(
    std::span<const Surface> all) const {
  geometry::BoundingBalls balls;
  const double arena = kHalf * std::sqrt(D) * cell_, beyond = arena + kMargin * cell_;
  for (const Surface& surface : all) {
    const Collider& to = to_[surface.collider];
    const geometry::BoundingBall ball = geometry::bounding_ball(to);
    const double way = to.velocity.norm() * dt_, turn = to.angular_velocity.norm() * dt_;
    const double size =
        (ball.radius + beyond + way + turn * (ball.center.norm() + arena + way)) / (1 - turn);
    balls.add(to.position() + to.rotation() * ball.center,
              turn < 0.5 ? size - beyond : std::numeric_limits<double>::infinity());
  }
  return balls;
}

// Whether a surface may be met in the arena, and where in it surely not.
//
// Convex solids: their distance is a convex function, so it is at least that of its tangent.
// Sampled distances: at least d(middle) - lipschitz |x - middle|. Each less the margin and the way
// of the collider in this step, since x and the collider both move.
template <class Real, int D>
bool ParticleBoundary<Real, D>::comes_near(const Collider& to, int axis, const Vec3& first,
                                           Free& free) const {
  const Vec3 middle = middle_of(first);
  const double radius = kHalf * std::sqrt(D) * cell_;
  const double way = surface_speed(to, middle, radius) * dt_;
  const double keep = kMargin * cell_ + way;
  // A linear function by its gradient and its value in the middle, and how far it goes from there.
  const auto linear = [&](const Vec3& gradient, double value) {
    double at_first = value / cell_, spread = 0;
    for (int d = 0; d < D; ++d) {
      free.row[d] = static_cast<Real>(gradient[d]);
      at_first -= kHalf * gradient[d];
      spread += kHalf * std::abs(gradient[d]);
    }
    free.row[D] = static_cast<Real>(at_first);
    return spread * cell_;
  };
  const auto ball = [&](const Vec3& centre, double size) {
    free.kind = size > 0 ? Free::kBall : Free::kNowhere;
    const Vec3 from = (centre - first) / cell_;
    for (int d = 0; d < D; ++d) free.row[d] = static_cast<Real>(from[d]);
    double flat = size / cell_ * (size / cell_);
    if constexpr (D == 2) flat -= from[2] * from[2];
    free.size = static_cast<Real>(flat);
    return size <= 0 || !((centre - middle).norm() + radius < size);
  };
  if (axis >= 0) {
    free.kind = Free::kSlab;
    const Vec3 direction = to.rotation().col(axis);
    const double value = direction.dot(middle - to.position());
    const double size = half_length(to, axis) - keep;
    free.size = static_cast<Real>(size / cell_);
    return !(std::abs(value) + linear(direction, value) < size);
  }
  if (const auto* sphere = std::get_if<Sphere>(&to.shape()); sphere && to.hollow()) {
    return ball(to.position(), sphere->radius - keep);
  }
  const auto [distance, gradient] = to.signed_distance(middle);
  if (!to.hollow() && geometry::is_convex(to.shape())) {
    free.kind = Free::kHalfSpace;
    return !(distance - keep - linear(gradient, distance - keep) > 0);
  }
  return ball(middle, (distance - kMargin * cell_) / to.lipschitz() - way);
}

template <class Real, int D>
double ParticleBoundary<Real, D>::surface_speed(const Collider& collider, const Vec3& centre,
                                                double radius) const {
  if (!moves(collider)) return 0;
  const double speed = collider.velocity.norm();
  const double arm = (centre - collider.position()).norm() + radius + speed * dt_;
  return speed + collider.angular_velocity.norm() * arm;
}

template <class Real, int D>
void ParticleBoundary<Real, D>::begin_step(const transfer::BlockLayout<D>& layout,
                                           bool layout_changed, std::span<const Collider> colliders,
                                           std::span<const double> masses, double dt, int threads) {
  masses_.assign(masses.begin(), masses.end());
  const bool same = !layout_changed && std::equal(colliders.begin(), colliders.end(), from_.begin(),
                                                  from_.end(), same_motion);
  const bool still = std::none_of(colliders.begin(), colliders.end(), moves);
  if (same && (still || dt == dt_)) {
    for (Near& near : near_) {
      near.excess = 0;
      for (Wall& wall : near.walls) wall.part = {};
    }
    for (std::size_t c = 0; c < colliders.size(); ++c) {
      from_[c].friction = to_[c].friction = colliders[c].friction;
      to_[c].body = colliders[c].body;
    }
    dt_ = dt;
    return;
  }
  dt_ = dt;
  sums_.resize(colliders.size());
  from_.clear();  // until all is found: where it fails, the next call begins anew
  std::vector<Collider> from(colliders.begin(), colliders.end());
  to_ = from;
  for (Collider& collider : to_) collider.advance(dt);
  collider_speed_ = 0;
  near_.clear();
  if (colliders.empty()) return;

  const auto blocks = static_cast<std::int64_t>(layout.particle_keys.size());
  constexpr std::int64_t kGrain = 64;
  const std::vector<Surface> all = surfaces(to_);
  const geometry::BoundingBalls balls = balls_with_ways(all);
  const double radius = kHalf * std::sqrt(D) * cell_;
  slots_.resize(layout.particle_keys.size());
  std::vector<std::vector<Near>> found(usize((blocks + kGrain - 1) / kGrain));
  parallel_for(
      blocks, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<std::int32_t> close;
        for (std::int64_t b = begin; b < end; ++b) {
          Near near;
          near.first = first_node(layout.particle_keys[usize(b)]);
          balls.find(middle_of(near.first), radius + kMargin * cell_, close);
          for (const std::int32_t s : close) {
            const Surface& surface = all[usize(s)];
            Wall wall{surface, {}, {}};
            if (comes_near(to_[surface.collider], surface.axis, near.first, wall.free)) {
              near.walls.push_back(wall);
            }
          }
          slots_[usize(b)] = near.walls.empty() ? -1 : 0;
          if (near.walls.empty()) continue;
          near.block = static_cast<std::int32_t>(b);
          found[usize(begin / kGrain)].push_back(std::move(near));
        }
      },
      threads);
  for (std::vector<Near>& part : found) {
    for (Near& near : part) {
      const Vec3 middle = middle_of(near.first);
      for (const Wall& wall : near.walls) {
        collider_speed_ =
            std::max(collider_speed_, surface_speed(from[wall.surface.collider], middle, radius));
      }
      slots_[usize(near.block)] = static_cast<std::int32_t>(near_.size());
      near_.push_back(std::move(near));
    }
  }
  from_ = std::move(from);
}

// Which of the lanes are not surely within `free`.
template <class Real, int D>
auto ParticleBoundary<Real, D>::outside(const Free& free, const Real* x) -> Mask {
  V at[D];
  for (int d = 0; d < D; ++d) at[d] = load<V>(x + d * kLanes<Real>);
  const auto value = [&] {
    V sum = splat<V>(free.row[D]);
    for (int d = 0; d < D; ++d) sum = fma<V>(free.row[d], at[d], sum);
    return sum;
  };
  Mask out = at[0] == at[0];
  if (free.kind == Free::kHalfSpace) {
    out = ~(value() >= 0);
  } else if (free.kind == Free::kSlab) {
    const V v = value();
    out = ~((v <= free.size) & (v >= -free.size));
  } else if (free.kind == Free::kBall) {
    V squared{};
    for (int d = 0; d < D; ++d) {
      const V way = at[d] - free.row[d];
      squared = fma<V>(way, way, squared);
    }
    out = ~(squared <= free.size);
  }
  return out;
}

// The same of one particle.
template <class Real, int D>
bool ParticleBoundary<Real, D>::outside(const Free& free, const Vec3& x) {
  double value = free.row[D], squared = 0;
  for (int d = 0; d < D; ++d) {
    value += free.row[d] * x[d];
    squared += (x[d] - free.row[d]) * (x[d] - free.row[d]);
  }
  switch (free.kind) {
    case Free::kHalfSpace:
      return !(value >= 0);
    case Free::kSlab:
      return !(std::abs(value) <= free.size);
    case Free::kBall:
      return !(squared <= free.size);
    default:
      return true;
  }
}

// Whether a ball about the ways of all lanes keeps clear of a sampled distance or a height
// field, which are slow to ask for each lane. (Particles of a packet are from neighbouring cells.)
template <class Real, int D>
bool ParticleBoundary<Real, D>::clears(const Near& near, const Wall& wall, const Real* before,
                                       const Real* x) const {
  const Collider& to = to_[wall.surface.collider];
  if (geometry::is_convex(to.shape())) return false;
  Vec3 low = Vec3::Zero(), high = Vec3::Zero();
  for (int d = 0; d < D; ++d) {
    const V a = load<V>(before + d * kLanes<Real>), b = load<V>(x + d * kLanes<Real>);
    const V less = a < b ? a : b, more = a < b ? b : a;
    Real least = less[0], most = more[0];
    for (int l = 1; l < kLanes<Real>; ++l) {
      least = std::min(least, less[l]);
      most = std::max(most, more[l]);
    }
    low[d] = cell_ * static_cast<double>(least);
    high[d] = cell_ * static_cast<double>(most);
  }
  const Vec3 centre = near.first + 0.5 * (low + high);
  const double radius = 0.5 * (high - low).norm();
  const double way = surface_speed(to, centre, radius) * dt_;
  return to.signed_distance(centre).value > to.lipschitz() * (radius + way) + kMargin * cell_;
}

template <class Real, int D>
void ParticleBoundary<Real, D>::settle(std::int32_t block, const Real* before, Real* x, Real* v,
                                       const Real* volume, double density, int count) {
  constexpr int kWidth = kLanes<Real>;
  Near& near = near_[usize(slots_[usize(block)])];
  Mask mask{};
  for (const Wall& wall : near.walls) {
    const Mask met = outside(wall.free, before) | outside(wall.free, x);
    if (any(met) && !clears(near, wall, before, x)) mask |= met;
  }
  if (!any(mask)) return;
  const double most = reach_ + kPush;
  for (int l = 0; l < count; ++l) {
    if (mask[l] == 0) continue;
    Vec3 came = near.first, at = near.first, velocity = Vec3::Zero();
    for (int d = 0; d < D; ++d) {
      came[d] += cell_ * static_cast<double>(before[d * kWidth + l]);
      at[d] += cell_ * static_cast<double>(x[d * kWidth + l]);
      velocity[d] = static_cast<double>(v[d * kWidth + l]);
    }
    if (!settle_one(near, came, at, velocity, density * static_cast<double>(volume[l]))) continue;
    for (int d = 0; d < D; ++d) {
      const auto start = static_cast<double>(before[d * kWidth + l]);
      const double way = std::clamp((at[d] - near.first[d]) / cell_ - start, -most, most);
      near.excess = std::max(near.excess, std::abs(way) - reach_);
      x[d * kWidth + l] = static_cast<Real>(start + way);
      v[d * kWidth + l] = static_cast<Real>(velocity[d]);
    }
  }
  for (int l = count; l < kWidth; ++l) {
    for (int d = 0; d < D; ++d) {
      x[d * kWidth + l] = x[d * kWidth + count - 1];
      v[d * kWidth + l] = v[d * kWidth + count - 1];
    }
  }
}

// How much of a change of a particle's velocity is its own: that of the collider's surface in the
// same direction, where all near to it push, is the rest.
template <class Real, int D>
double ParticleBoundary<Real, D>::share(const Collider& collider, std::size_t c, const Vec3& x,
                                        const Vec3& jump) const {
  const double squared = jump.squaredNorm();
  if (!(squared > 0)) return 1;
  Vec3 arm = x - collider.centre();
  if constexpr (D == 2) arm[2] = 0;
  const geometry::Vec6 along = geometry::wrench(arm, jump);
  return 1 / (1 + masses_[c] * along.dot(collider.body.mobility * along) / squared);
}

// One particle and all colliders near to it, in turn until none moves it any more. Returns whether
// any did.
template <class Real, int D>
bool ParticleBoundary<Real, D>::settle_one(Near& near, const Vec3& before, Vec3& x, Vec3& v,
                                           double mass) const {
  constexpr int kRounds = 4;
  const double margin = kMargin * cell_, negligible = 1e-12 * margin * margin;
  if (!x.allFinite()) return false;  // the check of the next grid finds it
  const Vec3 start = (before - near.first) / cell_;
  Vec3 at = (x - near.first) / cell_;
  bool moved = false;
  for (int round = 0; round < kRounds; ++round) {
    bool changed = false;
    for (Wall& wall : near.walls) {
      if (!outside(wall.free, start) && !outside(wall.free, at)) continue;
      const auto [c, axis] = wall.surface;
      const Collider &from = from_[c], &to = to_[c];
      const Vec3 came = to_local(from, before), target = to_local(to, x);
      const bool inside =
          !geometry::surely_beyond(from, came, 0) && !(local_distance(from, axis, came).value > 0);
      Vec3 p = held_off(from, axis, came, target, margin, inside);
      if (inside) {
        const double way = (p - target).norm(), most = kPush * cell_;
        if (way > most) p = target + most / way * (p - target);
      }
      Vec3 push = to.rotation() * (p - target);
      if constexpr (D == 2) push[2] = 0;
      if (!(push.squaredNorm() > negligible)) continue;
      x += push;
      at = (x - near.first) / cell_;
      changed = true;
      if (inside) continue;
      Vec3 n = to.rotation() * local_distance(from, axis, p).gradient;
      Vec3 surface = to.surface_velocity(x);
      if constexpr (D == 2) n[2] = surface[2] = 0;
      const double length = n.norm();
      if (length > 0) n /= length;
      if ((v - surface).dot(n) >= 0) continue;
      Vec3 after = conditioned(v, surface, n, boundaries_[c], to.friction);
      if (to.yields()) after = v + share(to, c, x, after - v) * (after - v);
      wall.part.add(x - to.position(), mass * (v - after));
      v = after;
    }
    if (!changed) break;
    moved = true;
  }
  return moved;
}

template <class Real, int D>
std::span<const Exchange> ParticleBoundary<Real, D>::sum_exchanges() noexcept {
  std::fill(sums_.begin(), sums_.end(), Exchange{});
  for (const Near& near : near_) {
    for (const Wall& wall : near.walls) sums_[wall.surface.collider] += wall.part;
  }
  return sums_;
}

template <class Real, int D>
double ParticleBoundary<Real, D>::excess() const {
  double most = 0;
  for (const Near& near : near_) most = std::max(most, near.excess);
  return most;
}

template class ParticleBoundary<float, 2>;
template class ParticleBoundary<float, 3>;
template class ParticleBoundary<double, 2>;
template class ParticleBoundary<double, 3>;

}  // namespace substep::mpm
