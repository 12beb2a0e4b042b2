// Symmetric 3 x 3 matrices in two rows of four numbers, as neighbours are loaded.
#pragma once

#include "substep/core/point.h"

namespace substep::pbf {

template <class Real>
struct Symmetric {
  Point<Real> diagonal{}, off{};  // xx, yy, zz and xy, xz, yz; w: not used

  static Symmetric identity() { return {{1, 1, 1, 0}, {}}; }
  Point<Real> times(const Point<Real>& v) const {
    return {diagonal.x * v.x + off.x * v.y + off.y * v.z,
            off.x * v.x + diagonal.y * v.y + off.z * v.z,
            off.y * v.x + off.z * v.y + diagonal.z * v.z, 0};
  }
  double determinant() const {
    const double a = diagonal.x, b = diagonal.y, c = diagonal.z, d = off.x, e = off.y, f = off.z;
    return a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e);
  }
  Symmetric inverse() const {
    const double a = diagonal.x, b = diagonal.y, c = diagonal.z, d = off.x, e = off.y, f = off.z,
                 det = determinant();
    const auto r = [&](double value) { return static_cast<Real>(value / det); };
    return {{r(b * c - f * f), r(a * c - e * e), r(a * b - d * d), 0},
            {r(e * f - d * c), r(d * f - e * b), r(d * e - a * f), 0}};
  }
};

}  // namespace substep::pbf
