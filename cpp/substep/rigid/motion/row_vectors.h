// Vec3 in the rows of bodies (body_rows.h).
#pragma once

#include "substep/core/point.h"
#include "substep/rigid/shapes/pose.h"

namespace substep::rigid {

inline Vec3 from_row(const Point<double>& p) { return {p.x, p.y, p.z}; }
inline void assign(Point<double>& p, const Vec3& v) { p.x = v.x(), p.y = v.y(), p.z = v.z(); }
inline void add(Point<double>& p, const Vec3& v) { p.x += v.x(), p.y += v.y(), p.z += v.z(); }

}  // namespace substep::rigid
