#include "substep/rigid/collision/capsule_contacts.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/geometry/closest_points.h"

namespace substep::rigid {
namespace {

constexpr double kParallel = 1e-2;   // [rad], within which lines touch along faces and each other
constexpr double kAxisSlack = 1e-4;  // of the radius, by which an axis may be beyond a face

// The t in [-1, 1] at which p + t d is closest to the box |x_i| <= h_i. The derivative of half the
// squared distance, sum_i d_i e_i with e_i the excess of coordinate i over the box, grows with t
// and is linear between the (at most six) t at which a coordinate enters or leaves its slab.
double closest_to_box(const Vec3& p, const Vec3& d, const Vec3& h) {
  const auto derivative = [&](double t) {
    double sum = 0;
    for (int i = 0; i < 3; ++i) {
      const double x = p[i] + t * d[i];
      sum += d[i] * (x - std::clamp(x, -h[i], h[i]));
    }
    return sum;
  };
  double low = -1, high = 1, f_low = derivative(low), f_high = derivative(high);
  if (f_low >= 0 && f_high <= 0) return 0;  // 0 all along
  if (f_low >= 0) return low;
  if (f_high <= 0) return high;
  for (int i = 0; i < 3; ++i) {
    if (d[i] == 0) continue;
    for (const double side : {-h[i], h[i]}) {
      const double t = (side - p[i]) / d[i];
      if (!(t > low && t < high)) continue;
      const double f = derivative(t);
      if (f == 0) return t;
      (f < 0 ? low : high) = t;
      (f < 0 ? f_low : f_high) = f;
    }
  }
  return low + (high - low) * (f_low / (f_low - f_high));
}

}  // namespace

bool capsule_capsule(const Capsule& a, const Pose& pose_a, const Capsule& b, const Pose& pose_b,
                     double margin, Manifold& manifold) {
  const Vec3 u = pose_a.rotation.col(2), v = pose_b.rotation.col(2), cross = u.cross(v);
  const Vec3 d_a = a.half_length * u, d_b = b.half_length * v;
  const Vec3 &x = pose_a.position, &y = pose_b.position;
  const auto [s, t] = geometry::closest_on_segments(x - d_a, x + d_a, y - d_b, y + d_b);
  const Vec3 p = x + (2 * s - 1) * d_a, q = y + (2 * t - 1) * d_b, d = q - p;
  const double distance = d.norm(), separation = distance - a.radius - b.radius;
  if (!(separation <= margin)) return true;
  if (cross.squaredNorm() < kParallel * kParallel) return false;
  Vec3 n;
  if (0 < s && s < 1 && 0 < t && t < 1) {  // they cross, also where the axes meet
    n = cross.normalized();
    if (n.dot(d) < 0) n = -n;
  } else if (distance > 1e-9 * a.radius) {
    n = d / distance;
  } else {
    return false;
  }
  manifold.normal = n;
  manifold.add({p + a.radius * n, q - b.radius * n, separation, 1});
  return true;
}

bool capsule_box(const Capsule& a, const Pose& pose_a, const Box& b, const Pose& pose_b,
                 double margin, Manifold& manifold) {
  const Vec3 p = pose_b.to_local(pose_a.position), &h = b.half_lengths;
  const Vec3 d = a.half_length * (pose_b.rotation.transpose() * pose_a.rotation.col(2));
  const Vec3 x = p + closest_to_box(p, d, h) * d, q = x.cwiseMax(-h).cwiseMin(h), e = x - q;
  const double distance = e.norm();
  if (!(distance - a.radius <= margin)) return true;
  if (!(distance > 1e-9 * a.radius)) return false;
  Vec3 n = e / distance;  // out of the box
  // The part of the axis that is above a face, or beside an edge, by its ends.
  double low = -1, high = 1;
  std::uint32_t low_name = 2, high_name = 3, along = 0;  // 0: a point
  const auto keep_within = [&](int k) {
    if (std::abs(p[k]) + std::abs(d[k]) <= h[k] + kAxisSlack * a.radius) return;
    if (d[k] == 0) high = low;  // beyond
    const double t0 = (-h[k] - p[k]) / d[k], t1 = (h[k] - p[k]) / d[k];
    const auto name = static_cast<std::uint32_t>(4 + 4 * k);
    if (std::min(t0, t1) > low) low = std::min(t0, t1), low_name = t0 < t1 ? name : name + 1;
    if (std::max(t0, t1) < high) high = std::max(t0, t1), high_name = t0 < t1 ? name + 3 : name + 2;
  };
  const auto is_long = [&] { return (high - low) * a.half_length > 1e-6 * a.radius; };
  int i, j;
  if (n.cwiseAbs().maxCoeff(&i) > 1 - 0.5 * kParallel * kParallel) {
    keep_within((i + 1) % 3), keep_within((i + 2) % 3);
    if (is_long()) {
      n = Vec3::Unit(i) * (n[i] < 0 ? -1 : 1);
      along = 1 + static_cast<std::uint32_t>(i);
    } else {
      low = -1, high = 1, low_name = 2, high_name = 3;
    }
  }
  d.cwiseAbs().maxCoeff(&j);
  if (along == 0 && std::abs(n[j]) < kParallel &&
      std::abs(d[j]) > (1 - 0.5 * kParallel * kParallel) * a.half_length) {
    keep_within(j);
    if (is_long()) {
      n[j] = 0, n.normalize();
      along = 4 + static_cast<std::uint32_t>(j);
    }
  }

  manifold.normal = -(pose_b.rotation * n);
  const auto add = [&](const Vec3& at, double height, std::uint32_t feature) {
    const double separation = height - a.radius;
    if (!(separation <= margin)) return;
    const Vec3 on_a = pose_b.to_world(at - a.radius * n);
    manifold.add({on_a, on_a + separation * manifold.normal, separation, feature});
  };
  if (along == 0) {  // a corner, an edge across, or little of a face
    add(x, distance, 1);
    return true;
  }
  const std::uint32_t name = along << 8 | (n.sum() > 0 ? 16 : 0);
  for (const auto& [t, end] : {std::pair(low, low_name), std::pair(high, high_name)}) {
    const Vec3 at = p + t * d;
    add(at, n.dot(at - q), name | end);
  }
  return true;
}

}  // namespace substep::rigid
