// Velocities of faces from those of the particles around.
#pragma once

#include <array>
#include <type_traits>

#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/particles/particles.h"

namespace substep::gridfluid {

// Numbers at faces, by component; each array has the layout's size.
template <class Real, int D>
using Faces = std::type_identity_t<std::array<Real*, D>>;
template <class Real, int D>
using ConstFaces = std::type_identity_t<std::array<const Real*, D>>;

// u = sum w v_p / sum w over the particles, w trilinear, and the sums of w; 0 and 0 at faces that
// no particle reaches. All particles have one mass. Affine particles count with v_p + C_p (x - x_p)
// at a face at x: Jiang, Schroeder, Selle, Teran, Stomakhin, "The affine particle-in-cell method",
// 2015, eq. 8. Momentum and, away from closed sides, angular momentum are conserved.
//
// The particles must be sorted on this layout; dx [m] is a cell. Ghosts are set (ghosts.h).
template <class Real, int D>
void transfer_to_grid(const Particles<Real, D>& particles, const Layout<D>& layout, Real dx,
                      const Faces<Real, D>& u, const Faces<Real, D>& weight, int threads);

}  // namespace substep::gridfluid
