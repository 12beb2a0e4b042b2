#include "substep/rigid/shapes/ray_cast.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

namespace substep::rigid {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// The part of a ray's line within a convex set, made smaller set by set.
struct Passage {
  double enter = -kInfinity, leave = kInfinity;
  Vec3 normal = Vec3::Zero();  // where it enters

  // By the half space normal . x <= offset.
  void cut(const Ray& ray, const Vec3& outward, double offset) {
    const double height = outward.dot(ray.origin) - offset, rate = outward.dot(ray.direction);
    if (rate < 0) {
      limit(height / -rate, outward);
    } else if (rate > 0) {
      leave = std::min(leave, height / -rate);
    } else if (height > 0) {
      leave = -kInfinity;
    }
  }
  void limit(double t, const Vec3& outward) {
    if (t > enter) enter = t, normal = outward;
  }
  std::optional<RayHit> hit(double length) const {
    if (!(enter >= 0 && enter <= leave && enter <= length)) return {};
    return RayHit{enter, normal};
  }
};

// Where the line o + t d is within r of 0; of two or three dimensions. The discriminant is made of
// the part of o across d, which does not cancel (Haines, Guenther, Akenine-Moeller, "Precision
// improvements for ray/sphere intersection", Ray Tracing Gems, 2019, ch. 7).
template <class V>
std::pair<double, double> within(const V& o, const V& d, double radius) {
  const double square = d.squaredNorm();
  const double excess = o.squaredNorm() - radius * radius;
  if (!(square > 0)) {
    return excess > 0 ? std::pair(kInfinity, -kInfinity) : std::pair(-kInfinity, kInfinity);
  }
  const double middle = -o.dot(d) / square;
  const V across = o + middle * d;
  const double discriminant = radius * radius - across.squaredNorm();
  if (!(discriminant >= 0)) return {kInfinity, -kInfinity};
  // t^2 - 2 middle t + excess / square = 0: the root of larger size first, the other from it.
  const double half = std::sqrt(discriminant / square);
  const double large = middle < 0 ? middle - half : middle + half;
  const double small = large != 0 ? excess / square / large : 0;
  return middle < 0 ? std::pair(large, small) : std::pair(small, large);
}

// The rays of these are in the frame of the shape.
std::optional<RayHit> cast(const Sphere& sphere, const Ray& ray) {
  Passage passage;
  std::tie(passage.enter, passage.leave) = within(ray.origin, ray.direction, sphere.radius);
  passage.normal = ray.at(passage.enter) / sphere.radius;
  return passage.hit(ray.length);
}

std::optional<RayHit> cast(const Box& box, const Ray& ray) {
  Passage passage;
  for (int i = 0; i < 3; ++i) {
    passage.cut(ray, Vec3::Unit(i), box.half_lengths[i]);
    passage.cut(ray, -Vec3::Unit(i), box.half_lengths[i]);
  }
  return passage.hit(ray.length);
}

void cut_sides(Passage& passage, const Ray& ray, double radius) {
  const auto [enter, leave] =
      within(ray.origin.head<2>().eval(), ray.direction.head<2>().eval(), radius);
  const Vec3 at = ray.at(enter);
  passage.limit(enter, Vec3(at.x(), at.y(), 0) / radius);
  passage.leave = std::min(passage.leave, leave);
}

void cut_ends(Passage& passage, const Ray& ray, double half_length) {
  passage.cut(ray, Vec3::UnitZ(), half_length);
  passage.cut(ray, -Vec3::UnitZ(), half_length);
}

std::optional<RayHit> cast(const Cylinder& cylinder, const Ray& ray) {
  Passage passage;
  cut_sides(passage, ray, cylinder.radius);
  cut_ends(passage, ray, cylinder.half_length);
  return passage.hit(ray.length);
}

// The union of a cylinder and two balls; what enters it enters one of them from outside of all.
std::optional<RayHit> cast(const Capsule& capsule, const Ray& ray) {
  Passage first;
  cut_sides(first, ray, capsule.radius);
  cut_ends(first, ray, capsule.half_length);
  if (first.enter > first.leave) first.enter = kInfinity;
  for (const double end : {-capsule.half_length, capsule.half_length}) {
    const Vec3 centre(0, 0, end);
    const auto [enter, leave] = within(Vec3(ray.origin - centre), ray.direction, capsule.radius);
    if (enter > leave) continue;
    if (enter < first.enter) {
      first.enter = enter;
      first.normal = (ray.at(enter) - centre) / capsule.radius;
    }
  }
  first.leave = kInfinity;
  return first.enter < kInfinity ? first.hit(ray.length) : std::nullopt;
}

std::optional<RayHit> cast(const Plane& plane, const Ray& ray) {
  Passage passage;
  passage.cut(ray, plane.normal, plane.offset);
  return passage.hit(ray.length);
}

std::optional<RayHit> cast(const std::shared_ptr<const ConvexHull>& hull, const Ray& ray) {
  Passage passage;
  for (int face = 0; face < hull->face_count(); ++face) {
    passage.cut(ray, hull->plane(face).normal, hull->plane(face).offset);
  }
  return passage.hit(ray.length);
}

// The volumes of the tetrahedra that the direction spans with the edges, seen from the origin, have
// one sign within the triangle. Two triangles compute the same numbers for a common edge, up to the
// sign, so no ray slips between them (as in Woop, Benthin, Wald, "Watertight ray/triangle
// intersection", JCGT 2(1), 2013).
std::optional<RayHit> cast(const TriangleMesh& mesh, int triangle, const Ray& ray) {
  const Vec3& n = mesh.normal(triangle);
  const double rate = n.dot(ray.direction);
  if (!(rate < 0)) return {};
  const auto& corner = mesh.face(triangle);
  const Vec3 a = mesh.vertices()[corner[0]] - ray.origin;
  const Vec3 b = mesh.vertices()[corner[1]] - ray.origin;
  const Vec3 c = mesh.vertices()[corner[2]] - ray.origin;
  const Vec3& d = ray.direction;
  if (d.dot(a.cross(b)) > 0 || d.dot(b.cross(c)) > 0 || d.dot(c.cross(a)) > 0) return {};
  const double t = n.dot(a) / rate;
  if (!(t >= 0 && t <= ray.length)) return {};
  return RayHit{t, n};
}

// Piece by piece of the part within the box of the mesh, each about as long as a triangle of an
// even mesh, until one holds a hit.
std::optional<RayHit> cast(const std::shared_ptr<const TriangleMesh>& mesh, const Ray& ray) {
  Passage box;
  for (int i = 0; i < 3; ++i) {
    box.cut(ray, Vec3::Unit(i), mesh->high()[i]);
    box.cut(ray, -Vec3::Unit(i), -mesh->low()[i]);
  }
  const double slack = 1e-9 * (mesh->high() - mesh->low()).norm();
  const double begin = std::max(box.enter - slack, 0.0);
  const double end = std::min(box.leave + slack, ray.length);
  if (!(begin <= end)) return {};
  const int pieces = static_cast<int>(std::ceil(std::sqrt(mesh->triangle_count())));
  std::optional<RayHit> nearest;
  for (int k = 0; k < pieces; ++k) {
    const double from = begin + (end - begin) * k / pieces;
    const double to = begin + (end - begin) * (k + 1) / pieces;
    const Vec3 p = ray.at(from), q = ray.at(to), room = Vec3::Constant(slack);
    mesh->for_each_in(p.cwiseMin(q) - room, p.cwiseMax(q) + room, [&](int triangle) {
      const auto hit = cast(*mesh, triangle, ray);
      if (hit && (!nearest || hit->distance < nearest->distance)) nearest = hit;
    });
    if (nearest && nearest->distance <= to) break;
  }
  return nearest;
}

}  // namespace

std::optional<RayHit> ray_cast(const Shape& shape, const Pose& pose, const Ray& ray) {
  const Ray local{pose.to_local(ray.origin), pose.rotation.transpose() * ray.direction, ray.length};
  auto hit = std::visit([&](const auto& s) { return cast(s, local); }, shape);
  if (hit) hit->normal = pose.rotation * hit->normal;
  return hit;
}

}  // namespace substep::rigid
