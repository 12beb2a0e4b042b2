#include "substep/rigid/collision/mesh_contacts.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "substep/geometry/closest_points.h"
#include "substep/rigid/collision/convex_contacts.h"
#include "substep/rigid/collision/face_patch.h"
#include "substep/rigid/shapes/view.h"

namespace substep::rigid {
namespace {

constexpr double kSameNormal = 1e-4;  // [rad]
// Of the shape's size. Where triangles of one normal differ in height by less than kLevelFaces none
// is the deepest; where a curved surface was joined to one normal there is no such play.
constexpr double kSamePoint = 1e-3, kSamePointDepth = 1e-5, kLevelFaces = 2e-3;

// A body that meets more normals than kMany, on a finely curved surface, has those within the first
// of these angles [rad] together that leaves no more. A ball touches at one point of them, the
// deepest, and has those within the first angle together always: it rolls from one to the next.
constexpr std::size_t kMany = 8;
constexpr double kTogether[] = {0.05, 0.1, 0.2, 0.4};

// Points with one normal from several triangles, in the frame of the mesh about the shape's origin,
// so that a shape far out on large ground is met as precisely.
struct Group {
  Vec3 normal;
  bool joined = false;  // several normals
  int count = 0;
  ContactPoint points[kMaxCorners];
};

class OnMesh {
 public:
  OnMesh(const Convex& shape, const Shape& kind, const Pose& pose, const TriangleMesh& mesh,
         double margin, std::vector<Group>& groups)
      : shape_(shape),
        kind_(kind),
        origin_(pose.position),
        pose_(Vec3::Zero(), pose.rotation),
        mesh_(mesh),
        margin_(margin),
        groups_(groups) {}

  void add(int triangle) {
    const auto& f = mesh_.face(triangle);
    const std::vector<Vec3>& v = mesh_.vertices();
    const Vec3 &n = mesh_.normal(triangle), &o = origin_;
    const TrianglePolytope arrays(v[f[0]] - o, v[f[1]] - o, v[f[2]] - o);
    const Vec3* corners = arrays.vertices;
    if (n.dot(pose_.to_world(shape_.centre) - corners[0]) < 0) return;  // behind it
    if (is_ball()) return add_ball(triangle, corners);
    const Convex flat{
        .core = Convex::Core::polytope,
        .polytope = arrays.polytope(),
        .size = shape_.size,
        .extent = std::max({corners[0].norm(), corners[1].norm(), corners[2].norm()})};
    const Difference difference{flat, shape_, pose_};
    const double enough = margin_ + shape_.rounding;
    if (difference.separation(n) > enough) return;
    const Axis best = best_axis(difference, enough);
    if (best.separation > enough) return;

    Manifold manifold;
    const auto salt = static_cast<std::uint32_t>(triangle) + 1;
    const bool supported = mesh_.supports(triangle, best.normal);
    const double preference = face_preference(flat, shape_);
    const auto patch = [&](const Vec3& normal, bool of_shape, double expected) {
      return face_patch(difference, normal, of_shape, expected, margin_, shape_.size, salt,
                        manifold);
    };
    const double s = difference.separation(n);
    const double expected = supported ? expected_over_face(difference, best, n, s) : 1e300;
    if (patch(n, false, expected) || !supported) return append(manifold);
    const FlatFace face = flat_face(shape_, -(pose_.rotation.transpose() * best.normal));
    const Vec3 down = face.exists ? Vec3(-(pose_.rotation * face.normal)) : best.normal;
    if (face.exists && mesh_.supports(triangle, down)) {
      const double t = difference.separation(down);
      if (t >= best.separation - preference && patch(down, true, t + 2 * preference)) {
        return append(manifold);
      }
    }
    manifold.normal = best.normal;
    manifold.add({best.on_a, best.on_a + (best.separation - shape_.rounding) * best.normal,
                  best.separation - shape_.rounding, salt});
    append(manifold);
  }

 private:
  bool is_ball() const { return std::holds_alternative<Sphere>(kind_); }

  // At the point nearest to its centre, the origin; at an edge or a corner only if the mesh is
  // convex there, else a neighbour has it.
  void add_ball(int triangle, const Vec3* corners) {
    const auto part =
        geometry::closest_on_triangle(Vec3::Zero(), corners[0], corners[1], corners[2]);
    const Vec3 foot = part[0] * corners[0] + part[1] * corners[1] + part[2] * corners[2];
    const bool inside = part[0] > 0 && part[1] > 0 && part[2] > 0;
    const Vec3& n = mesh_.normal(triangle);
    const double distance = inside ? -n.dot(corners[0]) : foot.norm();
    const double separation = distance - shape_.rounding;
    if (!(separation <= margin_) || !(distance > 0)) return;
    Manifold manifold;
    manifold.normal = inside ? n : Vec3(foot / -distance);
    if (!inside && !mesh_.supports(triangle, manifold.normal)) return;
    manifold.add({foot, foot + separation * manifold.normal, separation,
                  static_cast<std::uint32_t>(triangle) + 1});
    append(manifold);
  }

  void append(const Manifold& manifold) {
    if (manifold.count == 0) return;
    Group* group = nullptr;
    for (Group& g : groups_) {
      if ((g.normal - manifold.normal).squaredNorm() < kSameNormal * kSameNormal) group = &g;
    }
    if (!group) {
      groups_.emplace_back();
      group = &groups_.back();
      group->normal = manifold.normal;
    }
    for (int k = 0; k < manifold.count; ++k) add_point(*group, manifold.points[k]);
  }

  void add_point(Group& group, const ContactPoint& point) const {
    for (int j = 0; j < group.count; ++j) {
      ContactPoint& known = group.points[j];
      if (!((known.on_b - point.on_b).norm() < kSamePoint * shape_.size)) continue;
      // The deeper one; of equals a corner of the shape rather than of the triangle.
      const double tie = kSamePointDepth * shape_.size,
                   deeper = known.separation - point.separation;
      if (deeper > ((point.feature & kCutCorner) < (known.feature & kCutCorner) ? -tie : tie))
        known = point;
      return;
    }
    if (group.count == kMaxCorners) reduce_group(group);
    group.points[group.count++] = point;
  }

  // Groups whose normals are within an angle of that of a deeper one join it; their points keep
  // their separations.
  void join_groups(double angle) {
    for (Group& group : groups_) {
      std::swap(group.points[0], *std::min_element(group.points, group.points + group.count,
                                                   [](const auto& p, const auto& q) {
                                                     return p.separation < q.separation;
                                                   }));
    }
    std::stable_sort(groups_.begin(), groups_.end(), [](const Group& g, const Group& h) {
      return g.points[0].separation < h.points[0].separation;
    });
    std::vector<Group> joined;
    for (const Group& group : groups_) {
      const auto deeper = std::find_if(joined.begin(), joined.end(), [&](const Group& g) {
        return (g.normal - group.normal).squaredNorm() < angle * angle;
      });
      if (deeper == joined.end()) {
        joined.push_back(group);
        continue;
      }
      deeper->joined = true;
      if (is_ball()) continue;
      for (int k = 0; k < group.count; ++k) {
        ContactPoint point = group.points[k];
        point.on_a = point.on_b - point.separation * deeper->normal;
        add_point(*deeper, point);
      }
    }
    groups_ = std::move(joined);
  }

 public:
  void join_groups() {
    for (const double angle : kTogether) {
      if (groups_.size() > kMany || (is_ball() && angle == kTogether[0])) join_groups(angle);
    }
  }

  void reduce_group(Group& group) const {
    const Vec3& n = group.normal;
    const PlaneFrame frame(group.points[0].on_a, n,
                           std::abs(n.x()) < 0.7 ? Vec3::UnitX() : Vec3::UnitY());
    Patch patch;
    patch.count = group.count;
    for (int k = 0; k < group.count; ++k) {
      patch.corners[k] = frame.corner(group.points[k].on_a, 0, 0);
      patch.corners[k].height = group.points[k].separation;
    }
    const Reduced reduced =
        reduce(patch, margin_, (group.joined ? kSamePointDepth : kLevelFaces) * shape_.size);
    ContactPoint kept[4];
    for (int k = 0; k < reduced.count; ++k) kept[k] = group.points[reduced.index[k]];
    std::copy(kept, kept + reduced.count, group.points);
    group.count = reduced.count;
  }

 private:
  const Convex& shape_;
  const Shape& kind_;
  Vec3 origin_;
  Pose pose_;
  const TriangleMesh& mesh_;
  double margin_;
  std::vector<Group>& groups_;
};

// The normals found are from the mesh to the shape, those of the manifolds the other way.
void convex_mesh(const Convex& shape, const Shape& a, const Pose& pose_a, const TriangleMesh& mesh,
                 const Pose& pose_b, double margin, std::vector<Manifold>& manifolds) {
  const Pose pose = pose_a.relative_to(pose_b);
  const Bounds box = bounds(a, pose);
  const Vec3 around = Vec3::Constant(margin);
  std::vector<Group> groups;
  OnMesh on_mesh(shape, a, pose, mesh, margin, groups);
  mesh.for_each_in(box.low - around, box.high + around, [&](int t) { on_mesh.add(t); });
  on_mesh.join_groups();
  for (Group& group : groups) {
    on_mesh.reduce_group(group);
    Manifold& manifold = manifolds.emplace_back();
    manifold.normal = -(pose_b.rotation * group.normal);
    for (int k = 0; k < group.count; ++k) {
      const ContactPoint& p = group.points[k];
      manifold.add({pose_b.to_world(p.on_b + pose.position),
                    pose_b.to_world(p.on_a + pose.position), p.separation, p.feature});
    }
  }
}

}  // namespace

void collide_mesh(const Shape& a, const Pose& pose_a, const TriangleMesh& mesh, const Pose& pose_b,
                  double margin, std::vector<Manifold>& manifolds) {
  std::visit(
      [&](const auto& shape) {
        if constexpr (ConvexShape<decltype(shape)>) {
          const View view(shape);
          convex_mesh(view.convex, a, pose_a, mesh, pose_b, margin, manifolds);
        }
      },
      a);
}

}  // namespace substep::rigid
