// Energies and momenta of all particles.
#pragma once

#include "substep/geometry/vectors.h"

namespace substep::mpm {

// Sums over all particles. In 2D of a layer of 1 m.
struct Diagnostics {
  double mass = 0;                                   // [kg]
  double kinetic = 0, potential = 0, elastic = 0;    // [J]
  geometry::Vec3 momentum = geometry::Vec3::Zero();  // [N s]
  geometry::Vec3 angular_momentum =
      geometry::Vec3::Zero();  // about 0, with the affine part [N m s]
  double dissipated = 0;       // [J]

  Diagnostics& operator+=(const Diagnostics& other) {
    mass += other.mass;
    kinetic += other.kinetic;
    potential += other.potential;
    elastic += other.elastic;
    momentum += other.momentum;
    angular_momentum += other.angular_momentum;
    return *this;
  }
  double energy() const { return kinetic + potential + elastic; }
};

}  // namespace substep::mpm
