#include "substep/rigid/collision/plane_contacts.h"

namespace substep::rigid {
namespace {

struct WorldPlane {
  WorldPlane(const Plane& plane, const Pose& pose)
      : n(pose.rotation * plane.normal), offset(plane.offset + n.dot(pose.position)) {}
  double height(const Vec3& x) const { return n.dot(x) - offset; }

  Vec3 n;
  double offset;
};

void add_point(const Vec3& x, double height, const WorldPlane& plane, std::uint32_t feature,
               Manifold& manifold) {
  manifold.add({x, x - height * plane.n, height, feature});
}

}  // namespace

void sphere_plane(const Sphere& a, const Pose& pose_a, const Plane& b, const Pose& pose_b,
                  double margin, Manifold& manifold) {
  const WorldPlane plane(b, pose_b);
  const double height = plane.height(pose_a.position) - a.radius;
  if (!(height <= margin)) return;
  manifold.normal = -plane.n;
  add_point(pose_a.position - a.radius * plane.n, height, plane, 0, manifold);
}

// Its ends.
void capsule_plane(const Capsule& a, const Pose& pose_a, const Plane& b, const Pose& pose_b,
                   double margin, Manifold& manifold) {
  const WorldPlane plane(b, pose_b);
  const Vec3 along = a.half_length * pose_a.rotation.col(2);
  manifold.normal = -plane.n;
  for (const std::uint32_t end : {0u, 1u}) {
    const Vec3 centre = end == 0 ? Vec3(pose_a.position - along) : Vec3(pose_a.position + along);
    const double height = plane.height(centre) - a.radius;
    if (height <= margin) add_point(centre - a.radius * plane.n, height, plane, end, manifold);
  }
}

// The corners of the face that looks down most; all others are higher than one of them.
void box_plane(const Box& a, const Pose& pose_a, const Plane& b, const Pose& pose_b, double margin,
               Manifold& manifold) {
  const WorldPlane plane(b, pose_b);
  const Vec3 n = pose_a.rotation.transpose() * plane.n;
  const double centre = plane.height(pose_a.position);
  if (!(centre - n.cwiseAbs().dot(a.half_lengths) <= margin)) return;
  int axis;
  n.cwiseAbs().maxCoeff(&axis);
  const int u = (axis + 1) % 3, v = (axis + 2) % 3;
  manifold.normal = -plane.n;
  for (int k = 0; k < 4; ++k) {
    Vec3 corner;
    corner[axis] = n[axis] > 0 ? -a.half_lengths[axis] : a.half_lengths[axis];
    corner[u] = k == 1 || k == 2 ? a.half_lengths[u] : -a.half_lengths[u];
    corner[v] = k >= 2 ? a.half_lengths[v] : -a.half_lengths[v];
    const double height = centre + n.dot(corner);
    if (!(height <= margin)) continue;
    std::uint32_t feature = 0;
    for (int i = 0; i < 3; ++i) feature |= (corner[i] > 0 ? 1u : 0u) << i;
    add_point(pose_a.to_world(corner), height, plane, feature, manifold);
  }
}

}  // namespace substep::rigid
