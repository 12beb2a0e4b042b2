// What an implicit step asks of a material: the stress after a step, of particles in lanes of
// doubles, whatever the material and the precision of the particles are.
#pragma once

#include <memory>

#include "substep/core/lanes.h"
#include "substep/mpm/materials/materials.h"

namespace substep::mpm {

template <int D>
class ImplicitMaterial {
 public:
  using V = Vector<double>;
  static constexpr int kGradient = D * D;  // entries of H = dt grad v, rows are components of v

  virtual ~ImplicitMaterial() = default;

  // Whether the stress is that of an energy alone, so that the step minimises a potential.
  virtual bool hyperelastic() const = 0;
  virtual int fields() const = 0;

  // Brings the fields that a step of dt left to the yield surface.
  virtual void admit(V* fields, double dt) const = 0;

  // From the admissible fields at the start of the step: F = (I + H) F_n, the return map of this
  // trial state, and
  //   A = tau (I + H)^-T,    which is P F_n^T,
  // the derivative of the energy per undeformed volume by H. Two H at once; psi is 0 where the
  // material is not hyperelastic.
  virtual void stress(const V* fields, const V (&H)[2][kGradient], double dt, V (&A)[2][kGradient],
                      V (&psi)[2]) const = 0;
};

template <int D>
std::unique_ptr<ImplicitMaterial<D>> implicit_material(const AnyMaterial& material);

}  // namespace substep::mpm
