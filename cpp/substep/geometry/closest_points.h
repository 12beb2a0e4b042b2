// The points of two primitives that are closest to each other, as weights of their corners.
#pragma once

#include <algorithm>
#include <array>

#include "substep/geometry/vectors.h"

namespace substep::geometry {

// Of the triangle abc to p (Ericson, "Real-time collision detection", 2005, section 5.1.5).
inline std::array<double, 3> closest_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b,
                                                 const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) return {1 - d1 / (d1 - d3), d1 / (d1 - d3), 0};
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 > d6) return {1 - d2 / (d2 - d6), 0, d2 / (d2 - d6)};
  const double va = d3 * d6 - d5 * d4, along = d4 - d3, back = d5 - d6;
  if (va <= 0 && along >= 0 && back >= 0 && along + back > 0) {
    const double w = along / (along + back);
    return {0, 1 - w, w};
  }
  const double sum = va + vb + vc;
  if (!(sum > 0)) return {1, 0, 0};  // no triangle
  return {va / sum, vb / sum, vc / sum};
}

// Of the segments a0 a1 and b0 b1: the points a0 + s (a1 - a0) and b0 + t (b1 - b0) (Ericson 2005,
// section 5.1.9).
inline std::array<double, 2> closest_on_segments(const Vec3& a0, const Vec3& a1, const Vec3& b0,
                                                 const Vec3& b1) {
  const Vec3 da = a1 - a0, db = b1 - b0, r = a0 - b0;
  const double a = da.squaredNorm(), e = db.squaredNorm(), f = db.dot(r), c = da.dot(r);
  const auto unit = [](double x) { return std::clamp(x, 0.0, 1.0); };
  if (a == 0 && e == 0) return {0, 0};
  if (a == 0) return {0, unit(f / e)};
  if (e == 0) return {unit(-c / a), 0};
  const double b = da.dot(db), denominator = a * e - b * b;
  const double s = denominator > 0 ? unit((b * f - c * e) / denominator) : 0;
  const double t = (b * s + f) / e;
  if (t < 0) return {unit(-c / a), 0};
  if (t > 1) return {unit((b - c) / a), 1};
  return {s, t};
}

}  // namespace substep::geometry
