#include "substep/rigid/world/seams.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <type_traits>
#include <variant>

#include "substep/core/usize.h"
#include "substep/rigid/distance/time_of_impact.h"

namespace substep::rigid {
namespace {

constexpr double kParallel = 0.999;  // cosine of normals that are the same

// The largest d . x of the shape there; of a mesh, of its triangles within the bounds.
double reach(const Shape& shape, const Pose& pose, const Vec3& d, const Bounds& around) {
  constexpr double kInfinite = std::numeric_limits<double>::infinity();
  return std::visit(
      [&](const auto& one) {
        using S = std::remove_cvref_t<decltype(one)>;
        if constexpr (ConvexShape<S>) {
          return d.dot(pose.to_world(shape_of(one).support(pose.rotation.transpose() * d)));
        } else if constexpr (std::is_same_v<S, std::shared_ptr<const TriangleMesh>>) {
          const Mat3 to_mesh = pose.rotation.transpose();
          const Vec3 middle = to_mesh * (0.5 * (around.low + around.high) - pose.position),
                     half = to_mesh.cwiseAbs() * (0.5 * (around.high - around.low));
          double farthest = -kInfinite;
          one->for_each_in(middle - half, middle + half, [&](int triangle) {
            for (const std::int32_t v : one->face(triangle))
              farthest = std::max(farthest, d.dot(pose.to_world(one->vertices()[usize(v)])));
          });
          return farthest;
        } else {
          return kInfinite;
        }
      },
      shape);
}

}  // namespace

bool Seams::parted(const Edge& edge, const Fixtures& fixtures, std::span<const Way> ways) const {
  const double flush = kFlush * std::min(fixtures[edge.a].margin, fixtures[edge.b].margin);
  const auto reach_of = [&](std::int32_t f, const Pose& pose, const Vec3& m, std::int32_t near) {
    return reach(fixtures[f].fixture.shape, pose, m, fixtures.bounds()[usize(near)]);
  };
  // How much farther along m it will be as it turns: what rolls is not.
  const auto rises = [&](std::int32_t f, const Vec3& m, std::int32_t near, double now) {
    const Way& way = ways[usize(fixtures[f].body)];
    if (way.angle == 0) return 0.0;
    const Course course{.body = fixtures.body_pose(fixtures[f].body),
                        .turn = way.turn,
                        .local = fixtures[f].fixture.local};
    const double then =
        std::max(reach_of(f, course.at(0.5), m, near), reach_of(f, course.at(1), m, near));
    return std::max(then - now, 0.0);
  };
  // x lies on a third one at a face, and slides to y.
  const auto parts = [&](const Face& face, std::int32_t x, std::int32_t y) {
    const bool first = fixtures[face.a].body == fixtures[x].body;
    const std::int32_t ground = first ? face.b : face.a;
    const double sign = first ? 1 : -1, level = sign * face.level;
    const Vec3 m = sign * face.normal;
    if (ground == y || std::abs(m.dot(edge.normal)) > kParallel) return false;
    // By how much either is beyond the plane, and what both may come out of it in the step.
    const double x_along = reach_of(x, fixtures.pose(x), m, y),
                 y_along = reach_of(y, fixtures.pose(y), -m, x);
    const double over = x_along - level, up = y_along + level;
    const double comes =
        m.dot(ways[usize(fixtures[ground].body)].travel - ways[usize(fixtures[y].body)].travel);
    return over <= flush && up <= flush &&
           over + up + std::max(comes, 0.0) + rises(x, m, y, x_along) + rises(y, -m, x, y_along) <=
               2 * flush;
  };
  const auto any_face = [&](std::int32_t x, std::int32_t y) {
    const auto faces = of_body_.of(fixtures[x].body);
    return std::any_of(faces.begin(), faces.end(),
                       [&](std::int32_t k) { return parts(faces_[usize(k)], x, y); });
  };
  return any_face(edge.a, edge.b) || any_face(edge.b, edge.a);
}

}  // namespace substep::rigid
