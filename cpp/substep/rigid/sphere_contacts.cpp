#include "substep/rigid/sphere_contacts.h"

namespace substep::rigid {

void sphere_sphere(const Sphere& a, const Pose& pose_a, const Sphere& b, const Pose& pose_b,
                   double margin, Manifold& manifold) {
  const Vec3 d = pose_b.position - pose_a.position;
  const double distance = d.norm(), separation = distance - a.radius - b.radius;
  if (!(separation <= margin)) return;
  const Vec3 n = distance > 0 ? Vec3(d / distance) : Vec3::UnitZ();
  manifold.normal = n;
  manifold.add({pose_a.position + a.radius * n, pose_b.position - b.radius * n, separation, 0});
}

}  // namespace substep::rigid
