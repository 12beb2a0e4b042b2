// One view of all convex shapes for the algorithms that need no more than a support function: a
// core (polytope, segment along z, cylinder about z, or any other that has a support point) with
// `rounding` around it.
#pragma once

#include <cmath>

#include "substep/rigid/shapes/polytope.h"

namespace substep::rigid {

struct Convex {
  enum class Core { polytope, segment, cylinder, other };

  Core core;
  double radius = 0, half_length = 0;  // of segment and cylinder
  const void* shape = nullptr;         // of others, which must live as long
  Vec3 (*support_of_shape)(const void* shape, const Vec3& d) = nullptr;
  Polytope polytope;
  Vec3 centre = Vec3::Zero();  // a point inside
  double rounding = 0;
  double size;    // the smallest half length: the scale of tolerances
  double extent;  // the largest distance from the origin of the frame

  // The point of the core farthest along d; d may be 0.
  Vec3 support(const Vec3& d) const {
    switch (core) {
      case Core::polytope:
        return polytope.vertices[polytope.support_vertex(d)];
      case Core::segment:
        return {0, 0, d.z() < 0 ? -half_length : half_length};
      case Core::other:
        return support_of_shape(shape, d);
      case Core::cylinder:
        break;
    }
    const double square = d.x() * d.x() + d.y() * d.y();
    const double scale = square > 0 ? radius / std::sqrt(square) : 0;
    return {scale * d.x(), scale * d.y(), d.z() < 0 ? -half_length : half_length};
  }
};

}  // namespace substep::rigid
