// From the face that one shape turns to another to at most four points of contact.
//
// The face of the reference shape gives the plane and the sides, the face of the other one that
// looks against it, the incident face, is cut by the sides (Sutherland, Hodgman, "Reentrant polygon
// clipping", CACM 1974). All happens in coordinates (u, v) in the plane and the height above it.
#pragma once

#include <cstdint>

#include "substep/rigid/collision/manifold.h"

namespace substep::rigid {

// A corner of a polygon, and the names of the edges before and after it.
struct PatchCorner {
  double u, v, height;
  std::uint32_t before, after;
};

// A side: n_u u + n_v v <= offset; `edge` names what it cuts.
struct PatchSide {
  double n_u, n_v, offset;
  std::uint32_t edge;
};

// A polygon of at most kMaxCorners corners, with room for those that as many sides add; a segment
// (two corners) or a point (one).
inline constexpr int kMaxCorners = 32;
struct Patch {
  int count = 0;
  PatchCorner corners[2 * kMaxCorners];
};

// Cuts off what lies beyond the side, unless it is no more than `slack` [m]: corners of shapes that
// are aligned stay corners.
void clip(Patch& patch, const PatchSide& side, double slack);

// The corners no higher than `margin`, four of them where there are more: the deepest one, and
// those that with it span much area. Where all are within `level` [m] none is the deepest, so that
// the same four are kept while shapes lie on each other and tremble.
struct Reduced {
  int count = 0;
  int index[4];
};
Reduced reduce(const Patch& patch, double margin, double level);

// The name of a corner between a pair of faces.
inline std::uint32_t corner_feature(const PatchCorner& corner, std::uint32_t faces) {
  std::uint32_t h = faces * 0x9e3779b1u ^ (corner.before << 16 | corner.after);
  h = (h ^ h >> 16) * 0x85ebca6bu;  // a bijection of Murmur3's finalizer
  return h ^ h >> 13;
}

}  // namespace substep::rigid
