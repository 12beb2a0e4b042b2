#include "substep/mpm/implicit/material.h"

#include <algorithm>

namespace substep::mpm {
namespace {

template <class V>
void transposed_inverse(const V (&M)[4], const V& scale, V (&T)[4]) {
  const V s = scale / (M[0] * M[3] - M[1] * M[2]);
  T[0] = s * M[3], T[1] = -s * M[2], T[2] = -s * M[1], T[3] = s * M[0];
}
template <class V>
void transposed_inverse(const V (&M)[9], const V& scale, V (&T)[9]) {
  for (int i = 0; i < 3; ++i) {
    const int j = 3 * ((i + 1) % 3), k = 3 * ((i + 2) % 3);
    for (int c = 0; c < 3; ++c) {
      const int d = (c + 1) % 3, e = (c + 2) % 3;
      T[3 * i + c] = M[j + d] * M[k + e] - M[j + e] * M[k + d];
    }
  }
  const V s = scale / (M[0] * T[0] + M[1] * T[1] + M[2] * T[2]);
  for (V& entry : T) entry *= s;
}

template <class M, int D>
class Adapter final : public ImplicitMaterial<D> {
 public:
  using V = typename ImplicitMaterial<D>::V;
  static constexpr int kGradient = ImplicitMaterial<D>::kGradient;
  static constexpr int kFields = M::template kFields<D>;

  explicit Adapter(const M& material) : material_(material) {}
  bool hyperelastic() const override { return material_.hyperelastic(); }
  int fields() const override { return kFields; }

  void admit(V* fields, double dt) const override {
    V second[kFields];
    std::copy(fields, fields + kFields, second);
    V* const both[2] = {fields, second};
    const Tensor<V, D> rest[2] = {};
    SymmetricTensor<V, D> tau[2];
    kirchhoff(both, rest, dt, tau);
  }

  void stress(const V* fields, const V (&H)[2][kGradient], double dt, V (&A)[2][kGradient],
              V (&psi)[2]) const override {
    V trial[2][kFields];
    V* const both[2] = {trial[0], trial[1]};
    Tensor<V, D> G[2] = {};
    SymmetricTensor<V, D> tau[2];
    for (int p = 0; p < 2; ++p) {
      for (int k = 0; k < kGradient; ++k) G[p](k / D, k % D) = H[p][k] / dt;
      std::copy(fields, fields + kFields, trial[p]);
      material_.template advance<V, D>(trial[p], G[p], dt);
    }
    kirchhoff(both, G, dt, tau);
    for (int p = 0; p < 2; ++p) {
      V moved[kGradient], T[kGradient];
      for (int k = 0; k < kGradient; ++k) moved[k] = H[p][k] + (k % (D + 1) == 0 ? 1.0 : 0.0);
      transposed_inverse(moved, splat<V>(1), T);
      for (int i = 0; i < D; ++i) {
        for (int j = 0; j < D; ++j) {
          V sum{};
          for (int k = 0; k < D; ++k) sum += tau[p](i, k) * T[D * k + j];
          A[p][D * i + j] = sum;
        }
      }
      psi[p] = hyperelastic() ? material_.template energy_density<V, D>(trial[p]) : V{};
    }
  }

 private:
  // One copy of what takes longest to compile.
  [[gnu::noinline]] void kirchhoff(V* const (&fields)[2], const Tensor<V, D> (&G)[2], double dt,
                                   SymmetricTensor<V, D> (&tau)[2]) const {
    material_.template stress<V, D, 2>(fields, G, dt, tau);
  }

  M material_;
};

}  // namespace

template <int D>
std::unique_ptr<ImplicitMaterial<D>> implicit_material(const AnyMaterial& material) {
  return std::visit(
      []<class M>(const M& m) -> std::unique_ptr<ImplicitMaterial<D>> {
        return std::make_unique<Adapter<M, D>>(m);
      },
      material);
}

template std::unique_ptr<ImplicitMaterial<2>> implicit_material<2>(const AnyMaterial&);
template std::unique_ptr<ImplicitMaterial<3>> implicit_material<3>(const AnyMaterial&);

}  // namespace substep::mpm
