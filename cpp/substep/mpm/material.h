// What a material is: its own parameters, its own numbers per particle, and formulas over lanes.
//
// A step advances the deformation by the velocity gradient (advance), and later brings it back to
// the yield surface and returns the stress (stress): once each per step, in this order. So between
// steps the numbers are those of the trial state; `stress` with dt = 0 gives the admissible one.
#pragma once

#include <concepts>

#include "substep/mpm/tensor.h"

namespace substep::mpm {

// struct SomeMaterial {
//   static constexpr const char* kName;           // as in the list of materials and in Python
//   template <int D> static constexpr int kFields;  // numbers per particle: F (Tensor<V, D>)
//   first,
//                                                   // where there is an F; then its own
//   double density;                               // rho_0 [kg/m^3], and its other parameters
//
//   // The numbers of a particle at rest, one each.
//   template <int D> void initial(double* fields) const;
//   // Deformation after a step of dt in the velocity gradient G: F <- (I + dt G) F.
//   template <class V, int D>
//   void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const;
//   // Return map, then Kirchhoff stress tau = P F^T [Pa]: of kPackets packets at once, since the
//   // eigenvalues of one alone wait for their own results. Viscous materials read G, for tau
//   // alone: fields after the return map depend on fields and dt only. A field that
//   // is not finite, or det F <= 0 where the model has no answer, gives a tau that is NaN.
//   template <class V, int D, int kPackets>
//   void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&G)[kPackets], Lane<V> dt,
//               SymmetricTensor<V, D> (&tau)[kPackets]) const;
//   // Energy stored per undeformed volume [J/m^3]; 0 where the model has none.
//   template <class V, int D> V energy_density(const V* fields) const;
//   // rho_0 c^2 = lambda + 2 mu [Pa] at this state, hardening included: gives the CFL condition.
//   template <class V, int D> V wave_modulus(const V* fields) const;
//   // Bound of the viscous step: kinematic viscosity [m^2/s] (0 without).
//   double kinematic_viscosity() const;
// };
template <class M>
concept Material = requires(const M m, double* fields) {
  { M::kName } -> std::convertible_to<const char*>;
  { m.density } -> std::convertible_to<double>;
  { M::template kFields<3> } -> std::convertible_to<int>;
  m.template initial<3>(fields);
};

}  // namespace substep::mpm
