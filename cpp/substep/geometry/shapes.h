// Solid shapes with closed forms of their signed distance d (below 0 inside), its gradient and its
// Hessian, each in a frame of its own. d is exact, so |grad d| = 1 and a point may move by |d| in
// any direction without passing the surface. Where the nearest surface point is not unique the
// gradient is that of one of them: of the lowest axis for a box, +z at the centre of a sphere.
#pragma once

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

}  // namespace substep::geometry
