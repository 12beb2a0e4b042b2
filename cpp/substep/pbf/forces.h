// What acts on a fluid besides gravity and pressure, and when.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/pbf/neighbourhood.h"
#include "substep/pbf/options.h"
#include "substep/pbf/surface_tension.h"
#include "substep/pbf/viscosity.h"
#include "substep/pbf/vorticity.h"

namespace substep::pbf {

template <class Real>
class Forces {
 public:
  // Of particles in cell order with their lists: x and v have n + 1 rows (see Neighbourhood), fluid
  // n.
  struct Rows {
    const geometry::Neighbours<Real>& lists;
    std::span<const std::int32_t> fluid;
    Real h, volume;
    int dimension, threads;
  };

  // Surface tension of particles at x: moved += factor F / m, dt^2 for positions, dt for
  // velocities.
  void pull_together(const ForceOptions& options, const Rows& rows, double reference_mass,
                     double factor, std::span<const Point<Real>> x, std::span<Point<Real>> moved);
  // On velocities, after: viscosity, XSPH, vorticity confinement, in this order. w is kept.
  ViscosityReport act_on_velocities(const ForceOptions& options, const Rows& rows,
                                    std::span<const Point<Real>> x, double dt,
                                    std::vector<Point<Real>>& v);

 private:
  std::vector<Point<Real>> other_;  // a second copy of what is changed
  std::vector<Real> nu_;
  Viscosity<Real> viscosity_;
  VorticityConfinement<Real> confinement_;
  SurfaceTension<Real> surface_tension_;
};

extern template class Forces<float>;
extern template class Forces<double>;

}  // namespace substep::pbf
