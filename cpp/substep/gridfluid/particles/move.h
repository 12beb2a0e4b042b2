// From the grid back to the particles, and where these go.
#pragma once

#include <cstdint>

#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/particles/particles.h"
#include "substep/gridfluid/particles/transfer_to_grid.h"

namespace substep::gridfluid {

enum class Transfer : std::uint8_t {
  kPic,   // v = u(x): Harlow, "The particle-in-cell method for numerical solution of problems in
          // fluid dynamics", 1963
  kFlip,  // v = a (v + (u - u_old)(x)) + (1 - a) u(x): Brackbill, Ruppel, "FLIP: a method for
          // adaptively zoned, particle-in-cell calculations of fluid flows in two dimensions",
          // 1986; Zhu, Bridson, "Animating sand as a fluid", 2005
  kApic,  // v = u(x), C = grad u(x), that is sum u grad w: Jiang et al. 2015 (transfer_to_grid.h)
};

// What keeps particles in place.
template <class Real>
struct Walls {
  Real margin = Real(1e-3);        // [cells] from closed sides of the box
  const Real* solid = nullptr;     // signed distance from obstacles [cells] at the lower corners of
                                   // cells, and on the box's upper sides; no obstacles where null
  Real solid_margin = Real(1e-3);  // [cells] from obstacles
};

// A step from velocities u of the faces [m/s], whose ghosts are set.
template <class Real, int D>
struct Move {
  Transfer transfer = Transfer::kApic;
  Real flip_ratio = Real(0.97);  // a above
  ConstFaces<Real, D> u{};
  ConstFaces<Real, D> u_old{};  // of kFlip: as transferred to the grid
  Real dx = 1;                  // [m]
  Real dt = 0;                  // [s]
  Walls<Real> walls{};
};

// Sets the particles' velocities (and C) where they are.
template <class Real, int D>
void transfer_from_grid(Particles<Real, D>& particles, const Layout<D>& layout,
                        const Move<Real, D>& move, int threads);

// Moves them along u for dt by Ralston's method of third order: "Runge-Kutta methods with minimum
// error bounds", 1962, as in Bridson, "Fluid simulation for computer graphics", 2015, section 3.4.
// Then pushes them out of obstacles and keeps them in the box; through periodic sides they come in
// on the other side. Returns the first particle whose position or velocity is not finite, or -1.
template <class Real, int D>
std::int64_t advect(Particles<Real, D>& particles, const Layout<D>& layout,
                    const Move<Real, D>& move, int threads);

// Both in one pass.
template <class Real, int D>
std::int64_t transfer_and_advect(Particles<Real, D>& particles, const Layout<D>& layout,
                                 const Move<Real, D>& move, int threads);

// x += d(x), with displacements d of the faces [cells], whose ghosts are set. Returns as advect().
template <class Real, int D>
std::int64_t displace(Particles<Real, D>& particles, const Layout<D>& layout,
                      const ConstFaces<Real, D>& d, const Walls<Real>& walls, int threads);

}  // namespace substep::gridfluid
