#include "substep/rigid/collision/sphere_contacts.h"

#include <algorithm>

namespace substep::rigid {
namespace {

// Balls about x and y = x + d; `fallback` is the normal where the centres meet.
void balls(const Vec3& x, double radius_x, const Vec3& y, double radius_y, const Vec3& d,
           const Vec3& fallback, double margin, Manifold& manifold) {
  const double distance = d.norm(), separation = distance - radius_x - radius_y;
  if (!(separation <= margin)) return;
  const Vec3 n = distance > 0 ? Vec3(d / distance) : fallback;
  manifold.normal = n;
  manifold.add({x + radius_x * n, y - radius_y * n, separation, 1});
}

}  // namespace

void sphere_sphere(const Sphere& a, const Pose& pose_a, const Sphere& b, const Pose& pose_b,
                   double margin, Manifold& manifold) {
  balls(pose_a.position, a.radius, pose_b.position, b.radius, pose_b.position - pose_a.position,
        Vec3::UnitZ(), margin, manifold);
}

void sphere_capsule(const Sphere& a, const Pose& pose_a, const Capsule& b, const Pose& pose_b,
                    double margin, Manifold& manifold) {
  const Vec3 axis = pose_b.rotation.col(2), between = pose_b.position - pose_a.position;
  const double along = -axis.dot(between);
  const double t = std::clamp(along, -b.half_length, b.half_length);
  Vec3 d = between + t * axis;
  if (t == along) d -= axis.dot(d) * axis;  // across the axis also where it is but rounding
  balls(pose_a.position, a.radius, pose_b.position + t * axis, b.radius, d, pose_b.rotation.col(0),
        margin, manifold);
}

void sphere_box(const Sphere& a, const Pose& pose_a, const Box& b, const Pose& pose_b,
                double margin, Manifold& manifold) {
  const Vec3 p = pose_b.to_local(pose_a.position), &h = b.half_lengths;
  const Vec3 q = p.cwiseMax(-h).cwiseMin(h), d = p - q;
  const double square = d.squaredNorm();
  Vec3 n, foot = q;  // out of the box
  double distance;
  if (square > 0) {
    distance = std::sqrt(square);
    n = d / distance;
  } else {  // inside: out by the nearest face
    int axis;
    distance = (p.cwiseAbs() - h).maxCoeff(&axis);
    n = (p[axis] < 0 ? -1.0 : 1.0) * Vec3::Unit(axis);
    foot[axis] = n[axis] * h[axis];
  }
  const double separation = distance - a.radius;
  if (!(separation <= margin)) return;
  manifold.normal = -(pose_b.rotation * n);
  const Vec3 on_b = pose_b.to_world(foot);
  manifold.add({on_b - separation * manifold.normal, on_b, separation, 1});
}

}  // namespace substep::rigid
