// Stress and deformation of one packet of any material: the general path finds out which one it is
// once per packet.
#pragma once

#include <variant>

#include "substep/mpm/materials/materials.h"

namespace substep::mpm {

// tau [Pa] from the fields of a packet (kLanes numbers each), after the return map of a step of dt.
template <class Real, int D>
void packet_stress(const AnyMaterial& material, const Real* fields,
                   const Tensor<Vector<Real>, D>& G, Real dt,
                   SymmetricTensor<Vector<Real>, D>& tau);

// Where the fields are those of a trial state, the return map of the step before, which took
// `before`; then F <- (I + dt G) F, with the density around for those that see it.
template <class Real, int D>
void packet_advance(const AnyMaterial& material, Real* fields, bool trial, Real before,
                    const Tensor<Vector<Real>, D>& G, Real dt, const Vector<Real>& density_around);

// Whether F takes its change of volume from the cells.
inline bool averages_volume(const AnyMaterial& material) {
  return std::visit([]<class M>(const M&) { return averages_volume<M>(); }, material);
}

}  // namespace substep::mpm
