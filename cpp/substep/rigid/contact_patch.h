// From the face that one shape turns to another to at most four points of contact.
//
// The face of the reference shape gives the plane and the sides, the face of the other one that
// looks against it, the incident face, is cut by the sides (Sutherland, Hodgman, "Reentrant polygon
// clipping", CACM 1974). All happens in coordinates (u, v) in the plane and the height above it.
#pragma once

#include <cstdint>

#include "substep/rigid/manifold.h"

namespace substep::rigid {

// A corner of a polygon; `edge` names the edge to the next one.
struct PatchCorner {
  double u, v, height;
  std::uint32_t edge;
};

// A side: n_u u + n_v v <= offset; `edge` names what it cuts.
struct PatchSide {
  double n_u, n_v, offset;
  std::uint32_t edge;
};

// Room for the corners of a polygon of at most kMaxCorners cut by as many sides.
inline constexpr int kMaxCorners = 32;
struct Patch {
  int count = 0;
  PatchCorner corners[2 * kMaxCorners];
};

// Cuts off what lies beyond the side, unless it is no more than `slack` [m]: corners of shapes that
// are aligned stay corners.
void clip(Patch& patch, const PatchSide& side, double slack);

// The corners no higher than `margin`, four of them where there are more: the deepest one, and
// those that with it span much area. Corners within `tie` [m] of the deepest are as deep.
struct Reduced {
  int count = 0;
  int index[4];
};
Reduced reduce(const Patch& patch, double margin, double tie);

// The name of a corner: of the edges before and after it, each below 256, and of the pair of faces.
inline std::uint32_t corner_feature(const Patch& patch, int k, std::uint32_t faces) {
  const std::uint32_t before = patch.corners[k == 0 ? patch.count - 1 : k - 1].edge;
  return faces << 16 | before << 8 | patch.corners[k].edge;
}

}  // namespace substep::rigid
