#include "substep/pbf/boundary.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/parallel.h"

namespace substep::pbf {
namespace {

using geometry::Box;
using geometry::Collider;
using geometry::Plane;
using geometry::SampledDistance;
using geometry::Sphere;

constexpr double kMargin = 0.1;  // of the spacing, that particles keep from obstacles

template <class Real>
Vec3 vector(const Point<Real>& p) {
  return {p.x, p.y, p.z};
}

}  // namespace

template <class Real>
Boundary<Real>::Boundary(std::vector<Collider> obstacles, const DensityConstraint<Real>& density,
                         const Vec3& origin, int threads)
    : contact_(std::move(obstacles), origin, kMargin * density.options().spacing,
               density.options().dimension),
      radius_(density.radius()),
      dimension_(density.options().dimension) {
  const KernelFunction kernel = [&](double r) { return density.value(r); };
  const auto table = [&](double radius) {
    return std::make_shared<const DistanceTable>(kernel, radius_, dimension_, radius);
  };
  if (!colliders().empty()) plane_ = table(std::numeric_limits<double>::infinity());
  const auto add = [&](const Collider& collider) -> Wall {
    if (const auto* sphere = std::get_if<Sphere>(&collider.shape())) return table(sphere->radius);
    if (std::holds_alternative<Box>(collider.shape())) {
      if (!corner_) corner_ = std::make_shared<const CornerTable>(kernel, radius_, dimension_);
      if (collider.hollow()) return Tank{};
      return Block{};
    }
    if (std::holds_alternative<Plane>(collider.shape()) || dimension_ == 2) return plane_;
    const auto& field = *std::get<std::shared_ptr<const SampledDistance>>(collider.shape());
    return std::make_shared<const DensityMap>(field, collider.hollow(), kernel, radius_, threads);
  };
  for (const Collider& collider : colliders()) walls_.push_back(add(collider));
}

// Planes at distances s, less what lies beyond two of them, plus what beyond three.
template <class Real>
WallDensity Boundary<Real>::in_tank(const Vec3& half_lengths, const Vec3& x) const {
  const Vec3 s = half_lengths - x.cwiseAbs();  // from the nearer wall of each axis
  const int axes = dimension_;
  WallDensity result;
  int near = 0;
  bool is_near[3] = {};
  for (int axis = 0; axis < axes; ++axis) {
    if (s[axis] >= radius_) continue;
    if (2 * half_lengths[axis] - s[axis] < radius_) {  // the opposite wall, too
      WallDensity box = corner_->box(-half_lengths - x, half_lengths - x);
      return {1 - box.value, -box.gradient};
    }
    const auto [value, slope] = (*plane_)(s[axis]);
    result.value += value;
    result.gradient[axis] += x[axis] > 0 ? -slope : slope;
    is_near[axis] = true;
    ++near;
  }
  if (near < 2) return result;
  const auto add = [&](double sign, const Vec3& from) {
    const CornerTable::Octant o = corner_->octant(from.cwiseMax(0.0));
    result.value += sign * o[0];
    for (int axis = 0; axis < axes; ++axis) {
      const double slope = sign * o[static_cast<std::size_t>(axis) + 1];
      if (from[axis] > 0) result.gradient[axis] += x[axis] > 0 ? -slope : slope;
    }
  };
  for (int axis = 0; axis < 3; ++axis) {  // pairs of the two other axes
    const int a = (axis + 1) % 3, b = (axis + 2) % 3;
    if (!is_near[a] || !is_near[b]) continue;
    Vec3 from = s;
    from[axis] = 0;
    add(-2, from);
  }
  if (near == 3) add(1, s);
  return result;
}

// Of collider c at a point of its frame.
template <class Real>
WallDensity Boundary<Real>::wall_density(std::size_t c, const Vec3& local) const {
  const Collider& collider = colliders()[c];
  const Wall& wall = walls_[c];
  if (const auto* table = std::get_if<std::shared_ptr<const DistanceTable>>(&wall)) {
    const auto [d, gradient] = collider.local_distance(local);
    // What is outside of a ball is all but the ball, from the other side.
    const bool outside = collider.hollow() && std::holds_alternative<Sphere>(collider.shape());
    const auto [value, slope] = (**table)(outside ? -d : d);
    return {outside ? 1 - value : value, slope * gradient.normalized()};
  }
  if (const auto* map = std::get_if<std::shared_ptr<const DensityMap>>(&wall))
    return (**map)(local);
  const Vec3& half_lengths = std::get<Box>(collider.shape()).half_lengths;
  if (std::holds_alternative<Tank>(wall)) return in_tank(half_lengths, local);
  return corner_->box(-half_lengths - local, half_lengths - local);
}

template <class Real>
void Boundary<Real>::begin_step(double dt, std::span<Point<Real>> start, std::span<Point<Real>> x,
                                std::span<const Real> mass, int threads) {
  contact_.threads = threads;
  contact_.begin_step(static_cast<std::int64_t>(x.size()));
  contact_.clear(start, mass, x);
  contact_.begin_substep(dt);
  contact_.project(start, x, mass);
  find_near(x, threads);
}

template <class Real>
void Boundary<Real>::find_near(std::span<const Point<Real>> x, int threads) {
  constexpr std::int64_t kGrain = geometry::ParticleContact<Real>::kGrain, kBlock = 16;
  const auto n = static_cast<std::int64_t>(x.size());
  contributions_.assign(x.size(), Point<Real>{});
  near_.resize(static_cast<std::size_t>((n + kGrain - 1) / kGrain));
  if (colliders().empty()) return;
  // Sweeps move particles, by less than half of the radius as a rule; who comes near by more than
  // that is seen in the next step.
  const double reach = 1.5 * radius_;
  const auto find = [&](std::int64_t begin, std::int64_t end, std::vector<Near>& found) {
    Vec3 low = vector(x[begin]), high = low;
    for (std::int64_t i = begin + 1; i < end; ++i) {
      low = low.cwiseMin(vector(x[i])), high = high.cwiseMax(vector(x[i]));
    }
    const Vec3 center = contact_.origin() + 0.5 * (low + high);
    const double radius = 0.5 * (high - low).norm();
    std::vector<std::int32_t> candidates;
    for (std::size_t c = 0; c < colliders().size(); ++c) {
      const Collider& collider = colliders()[c];
      const double d = collider.signed_distance(center).value;
      if (d <= collider.lipschitz() * (radius + reach)) {
        candidates.push_back(static_cast<std::int32_t>(c));
      }
    }
    if (candidates.empty()) return;
    for (std::int64_t i = begin; i < end; ++i) {
      for (const std::int32_t c : candidates) {
        const Collider& collider = colliders()[static_cast<std::size_t>(c)];
        if (collider.signed_distance(contact_.origin() + vector(x[i])).value <
            collider.lipschitz() * reach) {
          found.push_back({static_cast<std::int32_t>(i), c, {}});
        }
      }
    }
  };
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<Near>& found = near_[static_cast<std::size_t>(begin / kGrain)];
        found.clear();
        for (std::int64_t i = begin; i < end; i += kBlock) {
          find(i, std::min(i + kBlock, end), found);
        }
      },
      threads);
}

template <class Real>
std::span<const Point<Real>> Boundary<Real>::contributions(std::span<const Point<Real>> x,
                                                           int threads) {
  const auto chunk = [&](std::int64_t k) {
    std::vector<Near>& near = near_[static_cast<std::size_t>(k)];
    for (const Near& entry : near) {
      contributions_[static_cast<std::size_t>(entry.particle)] = Point<Real>{};
    }
    for (Near& entry : near) {
      const auto c = static_cast<std::size_t>(entry.collider);
      const Collider& collider = colliders()[c];
      const Vec3 from = vector(x[entry.particle]) + (contact_.origin() - collider.position());
      const WallDensity wall = wall_density(c, collider.rotation().transpose() * from);
      const Vec3 g = collider.rotation() * wall.gradient;
      entry.gradient = {static_cast<Real>(g[0]), static_cast<Real>(g[1]),
                        dimension_ == 2 ? Real(0) : static_cast<Real>(g[2]),
                        static_cast<Real>(wall.value)};
      Point<Real>& sum = contributions_[static_cast<std::size_t>(entry.particle)];
      sum.x += entry.gradient.x, sum.y += entry.gradient.y, sum.z += entry.gradient.z;
      sum.w += entry.gradient.w;
    }
  };
  parallel_chunks(static_cast<std::int64_t>(near_.size()), chunk, threads);
  return contributions_;
}

template <class Real>
void Boundary<Real>::project(std::span<const Point<Real>> multipliers,
                             std::span<const Point<Real>> start, std::span<Point<Real>> x,
                             std::span<const Real> mass, int threads) {
  const auto chunk = [&](std::int64_t k) {
    for (const Near& entry : near_[static_cast<std::size_t>(k)]) {
      const auto i = static_cast<std::size_t>(entry.particle);
      const Real scale = x[i].w * multipliers[i].w;
      if (scale == 0 || entry.gradient.w == 0) continue;
      const Vec3 push = static_cast<double>(scale) * vector(entry.gradient);
      contact_.add_push(static_cast<std::size_t>(entry.collider), entry.particle, x[i], push,
                        mass[mass.size() == 1 ? 0 : i]);
    }
  };
  parallel_chunks(static_cast<std::int64_t>(near_.size()), chunk, threads);
  contact_.project(start, x, mass);
}

template <class Real>
void Boundary<Real>::end_step(std::span<const Point<Real>> start,
                              std::span<const Point<Real>> v_start, std::span<Point<Real>> v,
                              std::span<const Real> mass) {
  contact_.bounce(start, v_start, v, mass);
  contact_.end_step();
}

template class Boundary<float>;
template class Boundary<double>;

}  // namespace substep::pbf
