#include "substep/pbf/boundary.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/lanes.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::pbf {
namespace {

using geometry::Box;
using geometry::Collider;
using geometry::HeightField;
using geometry::Mat3;
using geometry::Plane;
using geometry::SampledDistance;
using geometry::Sphere;

constexpr double kMargin = 0.1;  // of the spacing, that particles keep from obstacles

}  // namespace

template <class Real>
Boundary<Real>::Boundary(std::vector<Collider> obstacles,
                         std::span<const geometry::Emitter> emitters,
                         const DensityConstraint<Real>& density, const Vec3& origin, int threads)
    : contact_(std::move(obstacles), origin, kMargin * density.options().spacing,
               density.options().dimension),
      radius_(density.radius()),
      spacing_(density.options().spacing),
      dimension_(density.options().dimension) {
  const KernelFunction kernel = [&](double r) { return density.value(r); };
  const auto table = [&](double radius) {
    return std::make_shared<const DistanceTable>(kernel, radius_, dimension_, radius);
  };
  if (!colliders().empty()) {
    mirror_ = std::make_shared<const Mirror>(
        DistanceTable(kernel, radius_, dimension_, std::numeric_limits<double>::infinity()),
        radius_, density.options().spacing, density.half_lattice());
  }
  const auto add = [&](const Collider& collider) -> Wall {
    if (const auto* sphere = std::get_if<Sphere>(&collider.shape())) return table(sphere->radius);
    if (std::holds_alternative<Box>(collider.shape())) {
      if (!corner_) corner_ = std::make_shared<const CornerTable>(kernel, radius_, dimension_);
      if (collider.hollow()) return Tank{};
      return Block{};
    }
    if (std::holds_alternative<geometry::Triangle>(collider.shape())) return Facet{};
    if (std::holds_alternative<Plane>(collider.shape()) || dimension_ == 2 ||
        std::holds_alternative<std::shared_ptr<const HeightField>>(collider.shape())) {
      return Flat{};
    }
    const auto* given = std::get_if<std::shared_ptr<const SampledDistance>>(&collider.shape());
    const auto field = given ? *given : sampled(collider.shape(), threads);
    return std::make_shared<const DensityMap>(*field, collider.hollow(), kernel, radius_, threads);
  };
  for (const Collider& collider : colliders()) walls_.push_back(add(collider));
  const double v = density.volume();
  for (const geometry::Emitter& emitter : emitters) {
    nozzles_.emplace_back(
        emitter, [density, v](double r) { return v * density.value(r); },
        [density, v](double r) { return v * density.slope(r); }, radius_);
  }
}

template <class Real>
void Boundary<Real>::place_layers(std::span<const std::int64_t> come, double time) {
  for (std::size_t k = 0; k < nozzles_.size(); ++k) nozzles_[k].place(come[k], time);
}

// One wall as a plane; where more meet, all but the box of those that the mirror makes of them.
template <class Real>
WallDensity Boundary<Real>::in_tank(const Vec3& half_lengths, const Vec3& x) const {
  WallDensity result;
  Vec3 low = Vec3::Constant(-radius_), high = -low, low_stretch = Vec3::Zero(),
       high_stretch = low_stretch;
  int near = 0;
  for (int axis = 0; axis < dimension_; ++axis) {
    const auto add = [&](double s, double sign, double& side, double& stretch) {
      if (s >= mirror_->reach()) return;
      const Mirror::Entry wall = (*mirror_)(s);
      side = sign * wall.distance;
      stretch = wall.stretch;
      result.value += wall.value;
      result.gradient[axis] -= sign * wall.slope;
      ++near;
    };
    add(half_lengths[axis] + x[axis], -1, low[axis], low_stretch[axis]);
    add(half_lengths[axis] - x[axis], 1, high[axis], high_stretch[axis]);
  }
  if (near < 2) return result;
  const auto [value, by_low, by_high] = corner_->box(low, high);
  return {1 - value, by_low.cwiseProduct(low_stretch) + by_high.cwiseProduct(high_stretch)};
}

// Of collider c at a point of its frame.
template <class Real>
WallDensity Boundary<Real>::wall_density(std::size_t c, const Vec3& local) const {
  const Collider& collider = colliders()[c];
  const Wall& wall = walls_[c];
  if (std::holds_alternative<Tank>(wall)) {
    return in_tank(std::get<Box>(collider.shape()).half_lengths, local);
  }
  const auto [d, slope] = collider.local_distance(local);
  const Vec3 n = slope.normalized();
  const Mirror::Entry mirrored = (*mirror_)(d);
  if (mirrored.value == 0) return {};
  if (std::holds_alternative<Flat>(wall) || std::holds_alternative<Facet>(wall)) {
    return {mirrored.value, mirrored.slope * n};
  }
  if (const auto* table = std::get_if<std::shared_ptr<const DistanceTable>>(&wall)) {
    // What is outside of a ball is all but the ball, from the other side.
    const double side = collider.hollow() ? -1 : 1;
    const auto [value, change] = (**table)(side * mirrored.distance);
    return {collider.hollow() ? 1 - value : value, change * mirrored.stretch * n};
  }
  // The particle as if at the distance that the mirror says.
  const Vec3 at = local + (mirrored.distance - d) * n;
  WallDensity result;
  if (const auto* map = std::get_if<std::shared_ptr<const DensityMap>>(&wall)) {
    result = (**map)(at);
  } else {
    const Vec3& half_lengths = std::get<Box>(collider.shape()).half_lengths;
    const auto [value, by_low, by_high] = corner_->box(-half_lengths - at, half_lengths - at);
    result = {value, -by_low - by_high};
  }
  result.gradient += (mirrored.stretch - 1) * n.dot(result.gradient) * n;
  return result;
}

template <class Real>
bool Boundary<Real>::begin_step(double dt, std::span<Point<Real>> start, std::span<Point<Real>> x,
                                std::span<const Real> mass, double reference_mass, int threads) {
  contact_.threads = threads;
  contact_.begin_step(static_cast<std::int64_t>(x.size()));
  const bool covered = contact_.clear(start, mass, x);
  bodies_.begin(contact_, reference_mass, dt, dimension_);
  contact_.begin_substep(dt);
  contact_.project(start, x, mass);
  note_near(x, threads);
  if (yields()) {
    bodies_.note(near_);
    bodies_.meet(contact_, start, x, mass);
    contact_.project(start, x, mass);
  }
  return covered;
}

template <class Real>
void Boundary<Real>::find_near(std::span<const Point<Real>> x, int threads) {
  contact_.place();
  note_near(x, threads);
}

template <class Real>
void Boundary<Real>::note_near(std::span<const Point<Real>> x, int threads) {
  constexpr std::int64_t kGrain = geometry::ParticleContact<Real>::kGrain;
  const auto n = static_cast<std::int64_t>(x.size());
  contributions_.assign(x.size(), Point<Real>{});
  near_.resize(usize((n + kGrain - 1) / kGrain));
  const auto facet = [](const Wall& wall) { return std::holds_alternative<Facet>(wall); };
  nearest_.resize(std::any_of(walls_.begin(), walls_.end(), facet) ? x.size() : 0);
  if (colliders().empty() && nozzles_.empty()) return;
  // Sweeps move particles, by less than a quarter of the radius as a rule; who comes near by more
  // than that is seen in the next step.
  const double reach = (mirror_ ? mirror_->reach() : 0) + 0.25 * radius_;
  const auto found = contact_.find_near(x, reach);
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<Near>& near = near_[usize(begin / kGrain)];
        near.clear();
        for (const auto& [c, i] : found[usize(begin / kGrain)]) near.push_back({i, c, {}});
        for (std::size_t k = 0; k < nozzles_.size(); ++k) {
          const auto number = static_cast<std::int32_t>(colliders().size() + k);
          for (auto i = static_cast<std::int32_t>(begin); i < end; ++i) {
            const Vec3 at = contact_.origin() + xyz(x[usize(i)]);
            if (nozzles_[k].near(at, 1.25 * radius_)) near.push_back({i, number, {}});
          }
        }
      },
      threads);
  const double half = 0.5 * spacing_;
  for (Nozzle& nozzle : nozzles_) {
    nozzle.leave_out([&](const Vec3& point) {
      return std::any_of(colliders().begin(), colliders().end(), [&](const Collider& collider) {
        return collider.signed_distance(point).value < half;
      });
    });
  }
}

// Of a wall or a nozzle at a point relative to the origin.
template <class Real>
SUBSTEP_INLINE WallDensity Boundary<Real>::density_of(std::size_t c, const Vec3& x) const {
  if (c >= colliders().size()) {
    return nozzles_[c - colliders().size()].density(contact_.origin() + x);
  }
  const Collider& collider = colliders()[c];
  const Vec3 from = x + (contact_.origin() - collider.position());
  const WallDensity wall = wall_density(c, collider.rotation().transpose() * from);
  return {wall.value, collider.rotation() * wall.gradient};
}

// Facets of a surface have space in common above their edges: it is to be filled once.
template <class Real>
void Boundary<Real>::find_nearest(std::span<const Point<Real>> x, std::span<const Near> near) {
  for (const Near& entry : near) nearest_[usize(entry.particle)] = {};
  for (const Near& entry : near) {
    const auto c = usize(entry.collider);
    if (c >= walls_.size() || !std::holds_alternative<Facet>(walls_[c])) continue;
    const Vec3 at = contact_.origin() + xyz(x[usize(entry.particle)]);
    const double d = colliders()[c].signed_distance(at).value;
    Nearest& best = nearest_[usize(entry.particle)];
    if (best.facet < 0 || d < best.distance) best = {entry.collider, d};
  }
}

template <class Real>
bool Boundary<Real>::other_is_nearer(const Near& entry) const {
  const auto c = usize(entry.collider);
  return !nearest_.empty() && c < walls_.size() && std::holds_alternative<Facet>(walls_[c]) &&
         nearest_[usize(entry.particle)].facet != entry.collider;
}

template <class Real>
std::span<const Point<Real>> Boundary<Real>::contributions(std::span<const Point<Real>> x,
                                                           int threads) {
  const auto chunk = [&](std::int64_t k) {
    std::vector<Near>& near = near_[usize(k)];
    for (const Near& entry : near) {
      contributions_[usize(entry.particle)] = Point<Real>{};
    }
    if (!nearest_.empty()) find_nearest(x, near);
    for (Near& entry : near) {
      entry.gradient = {};
      if (other_is_nearer(entry)) continue;
      const WallDensity wall = density_of(usize(entry.collider), xyz(x[entry.particle]));
      const Vec3& g = wall.gradient;
      entry.gradient = {static_cast<Real>(g[0]), static_cast<Real>(g[1]),
                        dimension_ == 2 ? Real(0) : static_cast<Real>(g[2]),
                        static_cast<Real>(wall.value)};
      Point<Real>& sum = contributions_[usize(entry.particle)];
      sum.x += entry.gradient.x, sum.y += entry.gradient.y, sum.z += entry.gradient.z;
      sum.w += entry.gradient.w;
    }
  };
  parallel_chunks(static_cast<std::int64_t>(near_.size()), chunk, threads);
  return contributions_;
}

template <class Real>
Vec3 Boundary<Real>::velocity_of(std::size_t c, const Vec3& x) const {
  if (c >= colliders().size()) return nozzles_[c - colliders().size()].velocity();
  const Collider& collider = colliders()[c];
  return collider.velocity +
         collider.angular_velocity.cross(x + (contact_.origin() - collider.position()));
}

template <class Real>
std::span<const Symmetric<Real>> Boundary<Real>::moments(std::span<const Point<Real>> x,
                                                         int threads) {
  moments_.assign(x.size(), Symmetric<Real>{});
  const auto add = [&](const Near& entry) {
    const Vec3 g = xyz(entry.gradient);
    if (g.isZero(0)) return;
    const auto c = usize(entry.collider);
    const double size = g.norm(), b = static_cast<double>(entry.gradient.w);
    double s = spacing_;  // where velocities are those of a nozzle: its last layer
    if (c < colliders().size()) {
      const Collider& collider = colliders()[c];
      const Vec3 from = xyz(x[usize(entry.particle)]) + (contact_.origin() - collider.position());
      s = std::max(collider.local_distance(collider.rotation().transpose() * from).value, 0.0);
    }
    const Mat3 m = b * Mat3::Identity() + (s / size - b / (size * size)) * g * g.transpose();
    const auto r = [&](int row, int column) { return static_cast<Real>(m(row, column)); };
    Symmetric<Real>& sum = moments_[usize(entry.particle)];
    sum.diagonal.x += r(0, 0), sum.diagonal.y += r(1, 1), sum.diagonal.z += r(2, 2);
    sum.off.x += r(0, 1), sum.off.y += r(0, 2), sum.off.z += r(1, 2);
  };
  parallel_chunks(
      static_cast<std::int64_t>(near_.size()),
      [&](std::int64_t k) {
        for (const Near& entry : near_[usize(k)]) add(entry);
      },
      threads);
  return moments_;
}

template <class Real>
void Boundary<Real>::project(std::span<const Point<Real>> multipliers,
                             std::span<const Point<Real>> start, std::span<Point<Real>> x,
                             std::span<const Real> mass, int threads) {
  const auto chunk = [&](std::int64_t k) {
    for (const Near& entry : near_[usize(k)]) {
      const auto i = usize(entry.particle);
      const Real scale = x[i].w * multipliers[i].w;
      const auto c = usize(entry.collider);
      if (scale == 0 || entry.gradient.w == 0 || c >= colliders().size() ||
          colliders()[c].yields()) {
        continue;
      }
      const Vec3 push = contact_.share * static_cast<double>(scale) * xyz(entry.gradient);
      contact_.add_push(c, entry.particle, x[i], push, mass[mass.size() == 1 ? 0 : i]);
    }
  };
  parallel_chunks(static_cast<std::int64_t>(near_.size()), chunk, threads);
  if (yields()) {
    bodies_.push(contact_, multipliers, x, mass);
    bodies_.meet(contact_, start, x, mass);
  }
  contact_.project(start, x, mass);
}

template <class Real>
void Boundary<Real>::end_step(std::span<const Point<Real>> start,
                              std::span<const Point<Real>> v_start, std::span<const Point<Real>> x,
                              std::span<Point<Real>> v, std::span<const Real> mass) {
  bodies_.rub(contact_, x, v, mass);
  contact_.bounce(start, v_start, v, mass);
  contact_.end_step();
  bodies_.end(contact_);
}

template class Boundary<float>;
template class Boundary<double>;

}  // namespace substep::pbf
