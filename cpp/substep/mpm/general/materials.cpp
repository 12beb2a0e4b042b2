#include "substep/mpm/general/materials.h"

#include <cstring>
#include <variant>

namespace substep::mpm {

namespace {

// One copy of what takes longest to compile.
template <class Real, int D, class M>
[[gnu::noinline]] SymmetricTensor<Vector<Real>, D> stress(const M& material, Vector<Real>* fields,
                                                          const Tensor<Vector<Real>, D>& G,
                                                          Real dt) {
  Vector<Real>* const packets[1] = {fields};
  const Tensor<Vector<Real>, D> gradients[1] = {G};
  SymmetricTensor<Vector<Real>, D> tau[1];
  material.template stress<Vector<Real>, D, 1>(packets, gradients, dt, tau);
  return tau[0];
}

}  // namespace

template <class Real, int D>
void packet_stress(const AnyMaterial& material, const Real* fields,
                   const Tensor<Vector<Real>, D>& G, Real dt,
                   SymmetricTensor<Vector<Real>, D>& tau) {
  std::visit(
      [&]<class M>(const M& m) {
        Vector<Real> f[M::template kFields<D>];
        std::memcpy(f, fields, sizeof f);
        tau = stress<Real, D>(m, f, G, dt);
      },
      material);
}

template <class Real, int D>
void packet_advance(const AnyMaterial& material, Real* fields, bool trial, Real before,
                    const Tensor<Vector<Real>, D>& G, Real dt, const Vector<Real>& density_around) {
  std::visit(
      [&]<class M>(const M& m) {
        Vector<Real> f[M::template kFields<D>];
        std::memcpy(f, fields, sizeof f);
        if (trial) stress<Real, D>(m, f, Tensor<Vector<Real>, D>{}, before);
        m.template advance<Vector<Real>, D>(f, G, dt);
        if constexpr (sees_density<M>()) m.template see<Vector<Real>>(f, density_around);
        std::memcpy(fields, f, sizeof f);
      },
      material);
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                           \
  template void packet_stress(const AnyMaterial&, const Real*, const Tensor<Vector<Real>, D>&, \
                              Real, SymmetricTensor<Vector<Real>, D>&);                        \
  template void packet_advance(const AnyMaterial&, Real*, bool, Real,                          \
                               const Tensor<Vector<Real>, D>&, Real, const Vector<Real>&);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::mpm
