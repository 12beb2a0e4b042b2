#include "substep/rigid/shapes/polytope.h"

namespace substep::rigid {
namespace {

// Faces -x, +x, -y, +y, -z, +z of a box, then those of a triangle.
constexpr std::int32_t kBoxFirst[] = {0, 4, 8, 12, 16, 20, 24};
constexpr std::int32_t kBoxCorners[] = {0, 4, 6, 2, 1, 3, 7, 5, 0, 1, 5, 4,
                                        2, 6, 7, 3, 0, 2, 3, 1, 4, 5, 7, 6};
constexpr std::int32_t kTriangleFirst[] = {0, 3, 6};
constexpr std::int32_t kTriangleCorners[] = {0, 1, 2, 0, 2, 1};

}  // namespace

BoxPolytope::BoxPolytope(const Vec3& h) {
  for (int k = 0; k < 8; ++k) {
    vertices[k] = {k & 1 ? h.x() : -h.x(), k & 2 ? h.y() : -h.y(), k & 4 ? h.z() : -h.z()};
  }
  for (int i = 0; i < 3; ++i) {
    planes[2 * i] = {-Vec3::Unit(i), h[i]};
    planes[2 * i + 1] = {Vec3::Unit(i), h[i]};
  }
}

Polytope BoxPolytope::polytope() const {
  return {vertices, planes, kBoxFirst, kBoxCorners, 1e-12 * vertices[7].norm()};
}

TrianglePolytope::TrianglePolytope(const Vec3& a, const Vec3& b, const Vec3& c)
    : vertices{a, b, c} {
  const Vec3 n = (b - a).cross(c - a).normalized();
  planes[0] = {n, n.dot(a)};
  planes[1] = {-n, -n.dot(a)};
}

Polytope TrianglePolytope::polytope() const {
  return {vertices, planes, kTriangleFirst, kTriangleCorners, 1e300};
}

}  // namespace substep::rigid
