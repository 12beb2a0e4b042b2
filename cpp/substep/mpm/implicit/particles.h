// The internal forces of an implicit step and their derivative, by passes over the particles.
//
// With v the velocities of the nodes at the end of the step and H_p = dt sum_i v_i g_ip^T / dx,
//   Psi(v) = sum_p V_p psi((I + H_p) F_p),     dPsi/dv_i = (dt / dx) sum_p V_p A_p g_ip,
// with A = P F^T of implicit/material.h (Gast et al., "Optimization integrator for large time
// steps", 2015, section 6; Stomakhin et al. 2013, eq. 6, with the nodes moved by dt v). The second
// derivative is applied particle by particle,
//   (K x)_i = sum_p C_p : (sum_j x_j g_jp^T) g_ip,     C_p = (dt / dx)^2 V_p dA_p/dH_p,
// where C_p, D^2 x D^2 numbers, comes from central differences of A in double precision: so any
// material serves that has a stress, viscous and plastic ones too.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "substep/mpm/implicit/material.h"
#include "substep/mpm/implicit/nodes.h"
#include "substep/mpm/particles/particles.h"

namespace substep::mpm {

template <int D>
class ImplicitParticles {
 public:
  using V = Vector<double>;
  static constexpr int kGradient = D * D;

  // Copies of the particles, brought to an admissible state, for a step of dt. `nodes` must live
  // on.
  template <class Real>
  void assign(const Particles<Real, D>& particles, const ImplicitNodes<D>& nodes, int order,
              Form form, double dt, int threads);

  // Whether all materials are hyperelastic, so that forces are those of a potential.
  bool hyperelastic() const;

  // H, A and energies at the velocities v; the sum of the energies [J] (0 without a potential).
  double evaluate(std::span<const double> v);
  // Adds dt times the internal forces of the last evaluate, with the sign of dPsi/dv [N s].
  void add_gradient(std::span<double> r);
  // C at the last evaluate.
  void linearise();
  // Sum of the volumes times a modulus there [J]: the energy is good to the rounding of this.
  double stiffness() const { return stiffness_; }
  // y += K x; and the diagonal D x D blocks of K, row by row (D x kNodeLanes<D> each).
  void add_product(std::span<const double> x, std::span<double> y);
  void add_diagonal(std::span<double> blocks);

 private:
  static constexpr int kLanesD = static_cast<int>(sizeof(V) / sizeof(double));
  static constexpr int kTangent = kGradient * D * kNodeLanes<D>;

  struct Group {
    std::unique_ptr<ImplicitMaterial<D>> material;
    int fields;
    std::vector<std::int64_t> first;  // packet of each particle block
    std::vector<std::int32_t> count;  // particles of each particle block
    std::vector<V> state;             // admissible fields at the start of the step
    std::vector<V> volume, H, A;      // V_p; D^2 numbers each
    std::vector<ImplicitStencil<D>> stencils;
    std::vector<float> tangent;  // kTangent of each particle: C, column by column
  };

  template <class Body>
  void for_blocks(const Body& body);  // body(block), any order
  template <class Body>
  void for_colours(const Body& body);  // body(block): no two at once whose arenas meet
  template <class Pass>
  void with_order(const Pass& pass);  // pass.template operator()<order + 1>()
  double sum_of_blocks() const;

  const ImplicitNodes<D>* nodes_ = nullptr;
  int order_ = 2, threads_ = 0;
  double dt_ = 0, scale_ = 0, stiffness_ = 0;
  std::vector<Group> groups_;
  std::vector<double> energies_;  // of each particle block; or stiffness
};

}  // namespace substep::mpm
