// What a material is: its own parameters, its own numbers per particle, and formulas over lanes.
//
// A step advances the deformation by the velocity gradient (advance), and later brings it back to
// the yield surface and returns the stress (stress): once each per step, in this order. So between
// steps the numbers are those of the trial state; `stress` with dt = 0 gives the admissible one.
#pragma once

#include <array>
#include <concepts>
#include <cstddef>
#include <limits>

#include "substep/core/usize.h"
#include "substep/mpm/materials/catalogue.h"
#include "substep/mpm/materials/tensor.h"

namespace substep::mpm {

// Numbers per particle: F (Tensor<V, D>) where there is one, then those of kState.
template <int D, std::size_t n>
constexpr int number_of_fields(bool has_F, const std::array<StateField, n>&) {
  return (has_F ? Tensor<float, D>::kEntries : 0) + static_cast<int>(n);
}

// struct SomeMaterial {
//   static constexpr const char* kName;  // as in the list of materials and in Python
//   static constexpr bool kHasF;         // whether the first of its numbers are those of F
//   static constexpr bool kInverts;      // whether det F < 0 has an answer
//   static constexpr std::array<StateField, n> kState;  // the others
//   template <int D> static constexpr int kFields;      // number_of_fields<D>(kHasF, kState)
//   double density;                      // rho_0 [kg/m^3], and its other parameters
//   template <class Constants>           // c(name), a number: from Python
//   static M with(const Constants& c);
//
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
//   // Energy stored per undeformed volume [J/m^3] of an admissible state.
//   template <class V, int D> V energy_density(const V* fields) const;
//   // d tau / d (log of stretch) [Pa] of the stiffest direction, not below: rho_0 c^2 of the
//   // fastest wave, so that it gives the CFL condition.
//   template <class V, int D> V wave_modulus(const V* fields) const;
//   // Bound of the explicit viscous step: kinematic viscosity [m^2/s] (0 without).
//   double kinematic_viscosity() const;
//   // Whether the stress is that of the energy alone: neither viscous nor plastic.
//   bool hyperelastic() const;
// };
template <class M>
concept Material =
    requires(const M m, Vector<double>* fields, Vector<double>* const (&of)[1],
             const Tensor<Vector<double>, 3>& G, const Tensor<Vector<double>, 3> (&gradients)[1],
             SymmetricTensor<Vector<double>, 3> (&tau)[1]) {
      { M::kName } -> std::convertible_to<const char*>;
      { M::kHasF } -> std::convertible_to<bool>;
      { M::kInverts } -> std::convertible_to<bool>;
      { M::kState.size() } -> std::convertible_to<std::size_t>;
      { M::template kFields<3> } -> std::convertible_to<int>;
      { m.density } -> std::convertible_to<double>;
      m.template advance<Vector<double>, 3>(fields, G, 1.0);
      m.template stress<Vector<double>, 3, 1>(of, gradients, 1.0, tau);
      { m.template energy_density<Vector<double>, 3>(fields) } -> std::same_as<Vector<double>>;
      { m.template wave_modulus<Vector<double>, 3>(fields) } -> std::same_as<Vector<double>>;
      { m.kinematic_viscosity() } -> std::same_as<double>;
      { m.hyperelastic() } -> std::same_as<bool>;
    };

// The numbers of a particle at rest.
template <class M, int D>
std::array<double, M::template kFields<D>> initial_fields() {
  std::array<double, M::template kFields<D>> fields{};
  if constexpr (M::kHasF) {
    for (const int k : {0, D + 1, Tensor<float, D>::kEntries - 1}) {
      fields[usize(k)] = 1;
    }
  }
  std::size_t k = fields.size() - M::kState.size();
  for (const StateField& field : M::kState) fields[k++] = field.initial;
  return fields;
}

// Lame's parameters [Pa]: mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu) (1 - 2 nu)), of Young's
// modulus E > 0 [Pa] and Poisson's ratio -1 < nu < 1/2.
struct Lame {
  double mu, lambda;
};
constexpr Lame lame_parameters(double youngs_modulus, double poisson_ratio) {
  return {youngs_modulus / (2 * (1 + poisson_ratio)),
          youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))};
}

template <class V>
SUBSTEP_INLINE V smaller(const V& a, const V& b) {  // b where a is NaN
  return a < b ? a : b;
}
template <class V>
SUBSTEP_INLINE V larger(const V& a, const V& b) {
  return a > b ? a : b;
}

// 0 where the mask is set, else NaN.
template <class V, class Mask>
SUBSTEP_INLINE V nan_unless(const Mask& valid) {
  return valid ? V{} : splat<V>(std::numeric_limits<Lane<V>>::quiet_NaN());
}

// Whether a material's F takes its change of volume from the cells (passes/packet_passes.h): one
// whose flow keeps volume would lock otherwise.
template <class M>
constexpr bool averages_volume() {
  if constexpr (requires { M::kAveragesVolume; }) {
    return M::kAveragesVolume;
  } else {
    return false;
  }
}

template <int D, class T>
constexpr T power(T x) {
  return D == 3 ? x * x * x : x * x;
}

// Whether a material's fields are told the density at the nodes around, after they advanced.
template <class M>
constexpr bool sees_density() {
  return requires { M::kSeesDensity; };
}

// G with this divergence in the place of its own.
template <class V, int D>
SUBSTEP_INLINE Tensor<V, D> with_divergence(Tensor<V, D> G, V divergence) {
  for (int d = 0; d < D; ++d) divergence -= G(d, d);
  for (int d = 0; d < D; ++d) G(d, d) += divergence * Lane<V>(1.0 / D);
  return G;
}

// Bound of the largest eigenvalue (Gershgorin): exact in principal axes.
template <class V, int D>
SUBSTEP_INLINE V largest_row(const SymmetricTensor<V, D>& b) {
  V largest = b.m[2];
  for (int i = 0; i < D; ++i) {
    V row = b.m[i];
    for (int j = 0; j < D; ++j) {
      if (j != i) row += larger<V>(b(i, j), -b(i, j));
    }
    largest = larger<V>(row, largest);
  }
  return largest;
}

}  // namespace substep::mpm
