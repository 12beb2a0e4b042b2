// A row of a particle array: a position or a velocity, and one number more that the owner of the
// array chooses (inverse mass, volume, multiplier). Four numbers are one aligned load, and four
// (eight, sixteen) such loads and a transpose fill lanes faster than gathers do.
#pragma once

namespace substep {

template <class Real>
struct alignas(4 * sizeof(Real)) Point {
  Real x, y, z, w;
};

}  // namespace substep
