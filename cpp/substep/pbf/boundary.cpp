#include "substep/pbf/boundary.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "substep/core/parallel.h"

namespace substep::pbf {
namespace {

using geometry::Collider;

constexpr int kCells = 512;            // of the table
constexpr std::int64_t kGrain = 1024;  // particles in a chunk

}  // namespace

template <class Real>
Boundary<Real>::Boundary(std::vector<Collider> obstacles, const DensityConstraint<Real>& density,
                         const Vec3& origin)
    : colliders(std::move(obstacles)),
      origin_(origin),
      radius_(density.radius()),
      clearance_(0.05 * density.options().spacing),
      table_(kCells + 2, Wall{0, 0}) {
  // a(z): the integral of W over the plane (in 2D the line) at distance z; b(s) that of a from s.
  constexpr int kRings = 400;
  const auto across = [&](double z) {
    const double reach = std::sqrt(std::max(0.0, radius_ * radius_ - z * z));
    double sum = 0;
    for (int k = 0; k < kRings; ++k) {
      const double r = reach * (k + 0.5) / kRings;
      sum += density.value(std::hypot(z, r)) *
             (density.options().dimension == 2 ? 2 : 2 * std::numbers::pi * r);
    }
    return sum * reach / kRings;
  };
  for (int k = kCells - 1; k >= 0; --k) {
    const double z = radius_ * k / kCells, step = radius_ / kCells;
    const double here = across(z), middle = across(z + step / 2), next = across(z + step);
    table_[k] = {table_[k + 1].value + step / 6 * (here + 4 * middle + next), -here};
  }
}

template <class Real>
typename Boundary<Real>::Wall Boundary<Real>::wall(double s) const {
  if (s >= radius_) return {0, 0};
  const double at = std::max(s, 0.0) / radius_ * kCells;
  const int k = static_cast<int>(at);
  const double f = at - k;
  return {table_[k].value + f * (table_[k + 1].value - table_[k].value),
          table_[k].slope + f * (table_[k + 1].slope - table_[k].slope)};
}

template <class Real>
template <class Visit>
void Boundary<Real>::for_walls(const Collider& collider, const Vec3& x, Visit&& visit) const {
  const auto* box = std::get_if<geometry::Box>(&collider.shape());
  if (box && collider.hollow()) {
    const geometry::Mat3 rotation = collider.orientation().toRotationMatrix();
    const Vec3 local = rotation.transpose() * (x - collider.position());
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3 n = rotation.col(axis);
      visit(box->half_lengths[axis] + local[axis], n);
      visit(box->half_lengths[axis] - local[axis], Vec3(-n));
    }
  } else {
    const geometry::SignedDistance d = collider.signed_distance(x);
    visit(d.value, Vec3(d.gradient.normalized()));
  }
}

template <class Real>
Vec3 Boundary<Real>::world(const Point<Real>& x) const {
  return origin_ +
         Vec3(static_cast<double>(x.x), static_cast<double>(x.y), static_cast<double>(x.z));
}

template <class Real>
void Boundary<Real>::find_near(std::span<const Point<Real>> x, int threads) {
  contributions_.assign(x.size(), Point<Real>{0, 0, 0, 0});
  near_.clear();
  if (colliders.empty()) return;
  const auto n = static_cast<std::int64_t>(x.size());
  std::vector<std::vector<std::int32_t>> found(static_cast<std::size_t>((n + kGrain - 1) / kGrain));
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          const Vec3 at = world(x[i]);
          if (std::any_of(colliders.begin(), colliders.end(), [&](const Collider& c) {
                return c.signed_distance(at).value < 2 * radius_;
              })) {
            found[begin / kGrain].push_back(static_cast<std::int32_t>(i));
          }
        }
      },
      threads);
  for (const auto& some : found) near_.insert(near_.end(), some.begin(), some.end());
}

template <class Real>
std::span<const Point<Real>> Boundary<Real>::contributions(std::span<const Point<Real>> x,
                                                           int threads) {
  parallel_for(
      static_cast<std::int64_t>(near_.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          const std::int32_t i = near_[k];
          const Vec3 at = world(x[i]);
          double b = 0;
          Vec3 gradient = Vec3::Zero();
          for (const Collider& collider : colliders) {
            for_walls(collider, at, [&](double s, const Vec3& n) {
              const Wall w = wall(s);
              b += w.value;
              gradient += w.slope * n;
            });
          }
          contributions_[i] = {static_cast<Real>(gradient.x()), static_cast<Real>(gradient.y()),
                               static_cast<Real>(gradient.z()), static_cast<Real>(b)};
        }
      },
      threads);
  return contributions_;
}

template <class Real>
void Boundary<Real>::push_out(std::span<Point<Real>> x, int threads) const {
  parallel_for(
      static_cast<std::int64_t>(near_.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          Point<Real>& p = x[near_[k]];
          Vec3 moved = Vec3::Zero();
          for (const Collider& collider : colliders) {
            for_walls(collider, world(p), [&](double s, const Vec3& n) {
              if (s < clearance_) moved += (clearance_ - s) * n;
            });
          }
          p.x += static_cast<Real>(moved.x());
          p.y += static_cast<Real>(moved.y());
          p.z += static_cast<Real>(moved.z());
        }
      },
      threads);
}

template class Boundary<float>;
template class Boundary<double>;

}  // namespace substep::pbf
