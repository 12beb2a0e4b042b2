#include "substep/rigid/shapes/shapes.h"

#include <limits>

namespace substep::rigid {
namespace {

// Half the extent along the axes of the world of what `half` is in the frame of the shape.
Vec3 half_extent(const Sphere& s, const Mat3&) { return Vec3::Constant(s.radius); }
Vec3 half_extent(const Box& b, const Mat3& R) { return R.cwiseAbs() * b.half_lengths; }
Vec3 half_extent(const Capsule& c, const Mat3& R) {
  return c.half_length * R.col(2).cwiseAbs() + Vec3::Constant(c.radius);
}
// The disc reaches r sqrt(1 - u_i^2) along the axis i, u being its normal.
Vec3 half_extent(const Cylinder& c, const Mat3& R) {
  const Vec3 u = R.col(2).cwiseAbs();
  return c.half_length * u + c.radius * R.leftCols<2>().rowwise().norm();
}
Vec3 half_extent(const Plane&, const Mat3&) {
  return Vec3::Constant(std::numeric_limits<double>::infinity());
}

Bounds bounds_of(const ConvexHull& hull, const Pose& pose) {
  Vec3 low = pose.to_world(hull.vertices()[0]), high = low;
  for (const Vec3& v : hull.vertices()) {
    const Vec3 x = pose.to_world(v);
    low = low.cwiseMin(x), high = high.cwiseMax(x);
  }
  return {low, high};
}

template <class S>
Bounds bounds_of(const S& shape, const Pose& pose) {
  const Vec3 half = half_extent(shape, pose.rotation);
  return {pose.position - half, pose.position + half};
}
Bounds bounds_of(const std::shared_ptr<const ConvexHull>& hull, const Pose& pose) {
  return bounds_of(*hull, pose);
}

// The box of the mesh, turned.
Bounds bounds_of(const std::shared_ptr<const TriangleMesh>& mesh, const Pose& pose) {
  const Vec3 low = mesh->low(), high = mesh->high();
  const Vec3 centre = pose.to_world((low + high) / 2);
  const Vec3 half = pose.rotation.cwiseAbs() * ((high - low) / 2);
  return {centre - half, centre + half};
}

}  // namespace

Bounds bounds(const Shape& shape, const Pose& pose) {
  return std::visit([&](const auto& s) { return bounds_of(s, pose); }, shape);
}

}  // namespace substep::rigid
