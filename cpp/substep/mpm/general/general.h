// The transfers of the material point method in their general form: any order of the spline, PIC,
// FLIP or APIC, MLS or textbook forces, on the same particles and blocks as the fast path.
//
// One step is p2g, the update of the grid, g2p:
//   p_i = sum_p w_ip (m v + m C (x_i - x_p)) + dt f_i        (C: APIC and AFLIP only)
//   f_i = -sum_p V_0 tau grad w_ip                           (textbook; V_0 tau = V sigma)
//       = -sum_p V_0 tau D^-1 w_ip (x_i - x_p)               (MLS)
//   v   = sum_i w_ip v_i                                     (PIC, APIC)
//       = sum_i w_ip v_i + alpha (v - sum_i w_ip v_i^before) (FLIP, AFLIP; alpha = exp(-flip_rate
//                                                             dt); v^before: p_i without f_i)
//   C   = sum_i v_i D^-1 w_ip (x_i - x_p)^T                  (AFLIP: and alpha times what of its
//         antisymmetric part was not seen in v^before, as for v, but for MUSL)
//   x  <- x + dt sum_i w_ip v_i
//   F  <- (I + dt G) F, G = sum_i v_i grad w_ip^T (textbook) or C (MLS); where the material asks
//   for
//         it, with the trace of the cells' divergence in the place of its own (packet_passes.h)
// Textbook: Sulsky, Chen, Schreyer, "A particle method for history-dependent materials", 1994, as
// in Jiang et al., "The material point method for simulating continuum materials", SIGGRAPH course,
// 2016. FLIP: Brackbill, Ruppel, "FLIP: a method for adaptively zoned, particle-in-cell
// calculations of fluid flows in two dimensions", 1986; the blend is per unit time here, so that it
// does not depend on the step. AFLIP: Fei, Guo, Wu, Huang, Gao, "Revisiting integration in the
// material point method", 2021, section 4, with that blend, and with the spin
// of particles, without which angular momentum would get lost. APIC: Jiang et al., "The affine
// particle-in-cell method", 2015. MLS: Hu et al., "A moving least squares material point method
// with displacement discontinuity and two-way rigid body coupling", 2018, eq. 16 to 18.
//
// D = sum w (x_i - x_p)(x_i - x_p)^T is dx^2/4 for order 2, dx^2/3 for order 3. For order 1 it
// depends on x_p and is singular at nodes, but D^-1 w (x_i - x_p) = grad w everywhere: so MLS and
// textbook are the same there, and the angular momentum of APIC's affine part is kept by each
// transfer, not by the motion of the particle between two (order 2 and 3 keep it by both).
//
// Modified update of stress last (MUSL). Where grad w does not vanish with w (order 1), nodes that
// particles hardly reach get f_i / m_i, and G and C with it, without bound. So, for G and C alone,
// light nodes take the velocity of what is there once particles have theirs:
//   v''_i = s_i v_i + (1 - s_i) v'_i, m_i v'_i = sum_p w_ip m (v + C (x_i - x_p))
// with v new, C (APIC, AFLIP) and x old. Sulsky, Zhou, Schreyer, "Application of a particle-in-cell
// method to solid mechanics", 1995: s_i = 0, as here for PIC and FLIP. That smooths strain rates,
// and with them C, in each step: where C is passed on s_i = min(1, sum_p w_ip), 1 where at least
// one particle's worth lies. So no force moves v'' by more than it would a particle.
//
// C is stored for PIC and FLIP too, where viscous materials read it and nothing else does; there
// it is G. Textbook with APIC gives viscous materials the affine fit C, not the spline's gradient.
#pragma once

#include "substep/mpm/particles/particles.h"
#include "substep/mpm/passes/options.h"
#include "substep/mpm/passes/transfers.h"

namespace substep::mpm {

// What passes between particles and grid, and how.
struct Scheme {
  int order = 2;
  Transfer transfer = Transfer::kApic;
  Form form = Form::kMls;
  double flip_rate = 0;  // [1/s]
  bool musl = false;     // light nodes deform particles by what remap() gives them
  bool averages = true;  // materials that take their change of volume from the cells do so
};

// Sets nodes (of particles.layout; sized here) from particles at rest, which do not change, for a
// step of dt [s]: momentum, with that of the internal forces, and mass. For FLIP and AFLIP `before`
// receives the same without the forces; for others it is left alone.
template <class Real, int D>
void p2g(const Scheme& scheme, const Particles<Real, D>& particles, double dt,
         Nodes<Real, D>& nodes, Nodes<Real, D>& before, int threads);

// Whether forces go with grad w: textbook, and order 1 in either form. Then nodes that particles
// hardly reach, whose mass goes with w, may be much faster than any particle, which sees w v_i.
inline bool uses_gradients(const Scheme& scheme) {
  return scheme.form == Form::kTextbook || scheme.order == 1;
}

// The greatest component of the velocities by which g2p would move particles [m/s].
template <class Real, int D>
double greatest_speed(const Scheme& scheme, const Particles<Real, D>& particles,
                      const Nodes<Real, D>& nodes, int threads);

// For MUSL, between the update of the grid and g2p: particles take their new v, and `after` (sized
// here) receives v''. g2p of `after` must follow.
template <class Real, int D>
void remap(const Scheme& scheme, Particles<Real, D>& particles, double dt,
           const Nodes<Real, D>& nodes, const Nodes<Real, D>& before, Nodes<Real, D>& after,
           int threads);

// Takes velocities, moves and deforms particles by dt, and leaves them at rest. `before` is what
// p2g set.
template <class Real, int D>
void g2p(const Scheme& scheme, Particles<Real, D>& particles, double dt,
         const Nodes<Real, D>& nodes, const Nodes<Real, D>& before, int threads);

}  // namespace substep::mpm
