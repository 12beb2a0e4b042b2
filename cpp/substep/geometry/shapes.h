// Solid shapes with closed forms of their signed distance d (below 0 inside), its gradient and its
// Hessian, each in a frame of its own. d is exact, so |grad d| = 1 and a point may move by |d| in
// any direction without passing the surface. Where the nearest surface point is not unique the
// gradient is that of one of them: of the lowest axis for a box, +z at the centre of a sphere,
// +x on the axis of capsules and cylinders, along (b - a) x (c - a) on a triangle. Defined in
// collider.cpp, whose queries they are.
#pragma once

#include "substep/geometry/vectors.h"

namespace substep::geometry {

struct SignedDistance {
  double value;
  Vec3 gradient;  // the derivative of value: of length 1 for exact distances
};

// The half space below the plane through the origin. d = n.x
struct Plane {
  Vec3 normal;  // of length 1

  SignedDistance signed_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  double lipschitz(bool) const { return 1; }
};

// d = |x| - r, grad d = x / |x|, H = (1 - n n^T) / |x|
struct Sphere {
  double radius;

  SignedDistance signed_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  double lipschitz(bool) const { return 1; }
};

// The box |x_i| <= a_i. With q = |x| - a, outside: d = |max(q, 0)|, whose Hessian is that of a
// sphere (a cylinder, a plane) about the nearest corner (edge, face); inside: d = max_i q_i.
struct Box {
  Vec3 half_lengths;

  SignedDistance signed_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  double lipschitz(bool) const { return 1; }
};

// The points within r of the segment |z| <= a of the z axis. With c the nearest point of the
// segment: d = |x - c| - r, whose Hessian is that of a sphere about an end, or of a cylinder.
struct Capsule {
  double radius, half_length;

  SignedDistance signed_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  double lipschitz(bool) const { return 1; }
};

// The cylinder rho <= r, |z| <= a, with rho the distance from the z axis and e its gradient. With
// q = (rho - r, |z| - a) as for a box: outside d = |max(q, 0)|, inside d = max(q_1, q_2). As
// hess rho = t t^T / rho for t along the circle, a distance of slope d_rho has besides the Hessian
// of a box in the plane of e and z the term d_rho t t^T / rho.
struct Cylinder {
  double radius, half_length;

  SignedDistance signed_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  double lipschitz(bool) const { return 1; }

 private:
  struct Parts {
    double rho, side, end;
    Vec3 e, up;
  };
  Parts parts(const Vec3& x) const;
};

// The points within r of the triangle abc. With c the nearest point of the triangle: d = |x - c| -
// r, whose Hessian is 0 above its inside, and that of a cylinder or of a sphere about an edge or a
// corner. It has two sides: within it the gradient leads to the side on which x lies.
struct Triangle {
  Vec3 a, b, c;
  double radius;

  SignedDistance signed_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  double lipschitz(bool) const { return 1; }
};

}  // namespace substep::geometry
