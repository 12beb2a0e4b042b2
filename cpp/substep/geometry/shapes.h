// Solid shapes with closed forms of their signed distance d (below 0 inside), its gradient and its
// Hessian, each in a frame of its own. d is exact, so |grad d| = 1 and a point may move by |d| in
// any direction without passing the surface. Where the nearest surface point is not unique the
// gradient is that of one of them: of the lowest axis for a box, +z at the centre of a sphere,
// +x on the axis of capsules and cylinders.
#pragma once

#include <algorithm>
#include <cmath>

#include "substep/geometry/vectors.h"

namespace substep::geometry {

struct SignedDistance {
  double value;
  Vec3 gradient;  // the derivative of value: of length 1 for exact distances
};

// The half space below the plane through the origin. d = n.x
struct Plane {
  Vec3 normal;  // of length 1

  SignedDistance signed_distance(const Vec3& x) const { return {normal.dot(x), normal}; }
  Mat3 hessian(const Vec3&) const { return Mat3::Zero(); }
  double lipschitz(bool) const { return 1; }
};

// d = |x| - r, grad d = x / |x|, H = (1 - n n^T) / |x|
struct Sphere {
  double radius;

  SignedDistance signed_distance(const Vec3& x) const {
    const double length = x.norm();
    return {length - radius, length > 0 ? Vec3(x / length) : Vec3::UnitZ()};
  }
  Mat3 hessian(const Vec3& x) const {
    const double length = x.norm();
    if (length == 0) return Mat3::Zero();
    const Vec3 n = x / length;
    return (Mat3::Identity() - n * n.transpose()) / length;
  }
  double lipschitz(bool) const { return 1; }
};

// The box |x_i| <= a_i. With q = |x| - a, outside: d = |max(q, 0)|, whose Hessian is that of a
// sphere (a cylinder, a plane) about the nearest corner (edge, face); inside: d = max_i q_i.
struct Box {
  Vec3 half_lengths;

  SignedDistance signed_distance(const Vec3& x) const {
    const Vec3 q = x.cwiseAbs() - half_lengths;
    const Vec3 outward = x.array().sign();
    if (q.maxCoeff() > 0) {
      const Vec3 beyond = q.cwiseMax(0.0);
      const double d = beyond.norm();
      return {d, outward.cwiseProduct(beyond) / d};
    }
    int axis;
    const double d = q.maxCoeff(&axis);
    return {d, x[axis] < 0 ? Vec3(-Vec3::Unit(axis)) : Vec3(Vec3::Unit(axis))};
  }
  Mat3 hessian(const Vec3& x) const {
    const Vec3 q = x.cwiseAbs() - half_lengths;
    if (q.maxCoeff() <= 0) return Mat3::Zero();
    const auto [d, n] = signed_distance(x);
    const Vec3 active = (q.array() > 0).cast<double>();
    return (Mat3(active.asDiagonal()) - n * n.transpose()) / d;
  }
  double lipschitz(bool) const { return 1; }
};

// The points within r of the segment |z| <= a of the z axis. With c the nearest point of the
// segment: d = |x - c| - r, whose Hessian is that of a sphere about an end, or of a cylinder.
struct Capsule {
  double radius, half_length;

  SignedDistance signed_distance(const Vec3& x) const {
    const Vec3 arm = x - Vec3(0, 0, std::clamp(x.z(), -half_length, half_length));
    const double length = arm.norm();
    return {length - radius, length > 0 ? Vec3(arm / length) : Vec3::UnitX()};
  }
  Mat3 hessian(const Vec3& x) const {
    const Vec3 arm = x - Vec3(0, 0, std::clamp(x.z(), -half_length, half_length));
    const double length = arm.norm();
    if (length == 0) return Mat3::Zero();
    const Vec3 n = arm / length, free(1, 1, std::abs(x.z()) > half_length ? 1 : 0);
    return (Mat3(free.asDiagonal()) - n * n.transpose()) / length;
  }
  double lipschitz(bool) const { return 1; }
};

// The cylinder rho <= r, |z| <= a, with rho the distance from the z axis and e its gradient. With
// q = (rho - r, |z| - a) as for a box: outside d = |max(q, 0)|, inside d = max(q_1, q_2). As
// hess rho = t t^T / rho for t along the circle, a distance of slope d_rho has besides the Hessian
// of a box in the plane of e and z the term d_rho t t^T / rho.
struct Cylinder {
  double radius, half_length;

  SignedDistance signed_distance(const Vec3& x) const {
    const Parts at = parts(x);
    if (at.side <= 0 && at.end <= 0) {
      return at.side > at.end ? SignedDistance{at.side, at.e} : SignedDistance{at.end, at.up};
    }
    const double side = std::max(at.side, 0.0), end = std::max(at.end, 0.0);
    const double d = std::hypot(side, end);
    return {d, (side * at.e + end * at.up) / d};
  }
  Mat3 hessian(const Vec3& x) const {
    const Parts at = parts(x);
    if (at.rho == 0) return Mat3::Zero();
    const Vec3 t(-at.e.y(), at.e.x(), 0);
    const auto [d, n] = signed_distance(x);
    Mat3 h = n.dot(at.e) / at.rho * t * t.transpose();
    if (at.side > 0 && at.end > 0) {
      h += (at.e * at.e.transpose() + at.up * at.up.transpose() - n * n.transpose()) / d;
    }
    return h;
  }
  double lipschitz(bool) const { return 1; }

 private:
  struct Parts {
    double rho, side, end;
    Vec3 e, up;
  };
  Parts parts(const Vec3& x) const {
    const double rho = std::hypot(x.x(), x.y());
    return {rho, rho - radius, std::abs(x.z()) - half_length,
            rho > 0 ? Vec3(x.x() / rho, x.y() / rho, 0) : Vec3::UnitX(),
            Vec3(0, 0, x.z() < 0 ? -1 : 1)};
  }
};

}  // namespace substep::geometry
