// A convex polytope as arrays that somebody else owns: a hull, a box, a triangle (with two faces).
#pragma once

#include <cstdint>
#include <span>

#include "substep/rigid/shapes/pose.h"

namespace substep::rigid {

// normal . x <= offset inside
struct FacePlane {
  Vec3 normal;
  double offset;
};

struct Polytope {
  std::span<const Vec3> vertices;
  std::span<const FacePlane> planes;
  std::span<const std::int32_t> first_corner, corners;  // of face f: [first[f], first[f + 1])
  double tolerance;  // [m], how far corners of a face may be from its plane

  // The vertex farthest along d, the lowest index where several are.
  int support_vertex(const Vec3& d) const {
    int best = 0;
    double most = vertices[0].dot(d);
    for (int k = 1; k < static_cast<int>(vertices.size()); ++k) {
      const double value = vertices[k].dot(d);
      if (value > most) most = value, best = k;
    }
    return best;
  }
  // Of the faces at that vertex the one whose normal is closest to d.
  int facing(const Vec3& d) const {
    const Vec3& v = vertices[support_vertex(d)];
    int best = -1;
    double most = 0;
    for (int k = 0; k < static_cast<int>(planes.size()); ++k) {
      const double value = planes[k].normal.dot(d);
      if (best >= 0 && !(value > most)) continue;
      if (planes[k].offset - planes[k].normal.dot(v) <= tolerance) most = value, best = k;
    }
    return best < 0 ? 0 : best;
  }
};

// A box as a polytope.
struct BoxPolytope {
  explicit BoxPolytope(const Vec3& half_lengths);
  Polytope polytope() const;

  Vec3 vertices[8];  // bit i of the index: + along axis i
  FacePlane planes[6];
};

// A triangle, both sides: face 0 is the one seen counter-clockwise.
struct TrianglePolytope {
  TrianglePolytope(const Vec3& a, const Vec3& b, const Vec3& c);
  Polytope polytope() const;

  Vec3 vertices[3];
  FacePlane planes[2];
};

}  // namespace substep::rigid
