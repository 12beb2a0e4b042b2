// What is measured of particles at rest: how fast their waves and they themselves are, energies,
// momenta, stresses.
#pragma once

#include "substep/geometry/vectors.h"
#include "substep/mpm/particles/diagnostics.h"
#include "substep/mpm/particles/particles.h"

namespace substep::mpm {

// Without `dissipated`. `affine`: C carries angular momentum (APIC); `moment`: of the kernel along
// an axis, sum w (x_i - x_p)^2 [cells^2].
template <class Real, int D>
Diagnostics measure(const Particles<Real, D>& particles, const geometry::Vec3& gravity, bool affine,
                    double moment, int threads);

// The largest c^2 = (lambda + 2 mu) / rho_0 of the elastic waves at the particles' state [m^2/s^2].
template <class Real, int D>
double wave_speed_squared(const Particles<Real, D>& particles, int threads);

// The largest component of a velocity [m/s].
template <class Real, int D>
double largest_speed(const Particles<Real, D>& particles, int threads);

// Of one packet: c^2 as above; energy density [J/m^3]; Kirchhoff stress of the admissible state
// [Pa], symmetric entries first to last, kLanes each.
template <class Real, int D>
void packet_wave_speeds(const Particles<Real, D>& particles, std::size_t group, std::int64_t packet,
                        double* squares);
template <class Real, int D>
void packet_energy(const Particles<Real, D>& particles, std::size_t group, std::int64_t packet,
                   Real* energy);
template <class Real, int D>
void packet_stress_at_rest(const Particles<Real, D>& particles, std::size_t group,
                           std::int64_t packet, Real* tau);

}  // namespace substep::mpm
