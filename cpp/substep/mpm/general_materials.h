// Stress and deformation of one packet of any material: the general path finds out which one it is
// once per packet.
#pragma once

#include "substep/mpm/materials.h"

namespace substep::mpm {

// tau [Pa] from the fields of a packet (kLanes numbers each), after their return map.
template <class Real, int D>
void packet_stress(const AnyMaterial& material, const Real* fields,
                   const Tensor<Vector<Real>, D>& G, Real dt,
                   SymmetricTensor<Vector<Real>, D>& tau);

// Return map where the fields are those of a trial state, then F <- (I + dt G) F.
template <class Real, int D>
void packet_advance(const AnyMaterial& material, Real* fields, bool trial,
                    const Tensor<Vector<Real>, D>& G, Real dt);

}  // namespace substep::mpm
