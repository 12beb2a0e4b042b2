// The convex hull of points, by quickhull (Barber, Dobkin, Huhdanpaa, "The quickhull algorithm for
// convex hulls", ACM TOMS 22(4), 1996), as a polytope with flat faces: triangles in one plane are
// one face, corners are where three faces or more meet.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/shapes/shape.h"

namespace substep::rigid {

class ConvexHull {
 public:
  // Points no further than 1e-9 of the extent out of a face are dropped, faces whose corners differ
  // by less than 1e-7 of it from one plane are merged. InputError: a point is not finite, or all
  // lie in a plane within 1e-6 of the extent. The result depends on the points and their order
  // only.
  explicit ConvexHull(std::span<const Vec3> points);

  int vertex_count() const { return static_cast<int>(vertices_.size()); }
  const std::vector<Vec3>& vertices() const { return vertices_; }
  int face_count() const { return static_cast<int>(planes_.size()); }
  const FacePlane& plane(int face) const { return planes_[face]; }
  // Corners of a face, counter-clockwise seen from outside.
  std::span<const std::int32_t> corners(int face) const {
    return {corners_.data() + first_corner_[face],
            usize(first_corner_[face + 1] - first_corner_[face])};
  }
  const Vec3& centre() const { return centre_; }   // the mean of the vertices
  double radius() const { return radius_; }        // of the sphere about the origin around it
  double thickness() const { return thickness_; }  // half the least extent along an axis

  Polytope polytope() const {
    return {.vertices = vertices_,
            .planes = planes_,
            .first_corner = first_corner_,
            .corners = corners_,
            .tolerance = 2e-7 * radius_};
  }

  // As shape.h says.
  Vec3 support(const Vec3& d) const { return vertices_[polytope().support_vertex(d)]; }
  Bounds bounds(const Pose& pose) const;
  Ball inner_ball() const;
  double outer_radius(const Pose& local) const;
  MassMoments moments(double density) const;
  std::optional<RayHit> cast(const Ray& ray) const;
  Convex convex() const {
    return {.core = Convex::Core::polytope,
            .polytope = polytope(),
            .centre = centre_,
            .size = thickness_,
            .extent = radius_};
  }

 private:
  std::vector<Vec3> vertices_;
  std::vector<FacePlane> planes_;
  std::vector<std::int32_t> first_corner_, corners_;
  Vec3 centre_ = Vec3::Zero();
  double radius_ = 0, thickness_ = 0;
};

}  // namespace substep::rigid
