// Clusters of any number of particles that keep their shape: Mueller, Heidelberger, Teschner,
// Gross, "Meshless deformations based on shape matching", SIGGRAPH 2005, as XPBD constraints.
//
// A cluster has rest positions q_i about their centre of mass and pulls its particles to the goals
//
//   g_i = T q_i + c,   c = sum m_i x_i / sum m_i,   A = sum m_i (x_i - c) q_i^T        (eq. 3-7)
//   T = (1 - beta) R + beta B / det(B)^(1/3),   B = A (sum m_i q_i q_i^T)^-1           (eq. 9)
//
// with R the rotation of the polar decomposition of A, from its singular values with the sign of
// det A in the smallest (Irving et al. 2004): a rotation for every A, so that inverted clusters
// turn back. Where B is singular (a flat cluster) or inverted, T = R. As R minimises sum m_i |x_i -
// g_i|^2, the constraint
//
//   C = sqrt(sum m_i |x_i - g_i|^2),   dC/dx_i = m_i (x_i - g_i) / C,   sum w_i |dC/dx_i|^2 = 1
//
// has the energy C^2 / (2 alpha) of springs of stiffness m_i / alpha to the goals: alpha [s^2], and
// without compliance x_i = g_i in one projection. (For beta > 0 the gradient leaves out dT/dx.)
// The corrections keep linear and angular momentum, A T^T being symmetric. A pinned particle counts
// with the mass of all free ones together and stays; a cluster without free particles is skipped.
//
// Clusters that share no particle are projected at once, by colours; sums are in double.
#pragma once

#include <array>
#include <vector>

#include "substep/core/matrix3.h"
#include "substep/pbd/groups/clusters.h"
#include "substep/pbd/groups/group.h"

namespace substep::pbd {

template <class Real>
class ShapeMatching final : public Group<Real> {
 public:
  explicit ShapeMatching(Clusters clusters);

  std::unique_ptr<Group<Real>> clone() const override {
    return std::make_unique<ShapeMatching>(*this);
  }
  std::int64_t size() const override { return static_cast<std::int64_t>(lambda_.size()); }
  void attach(const Partition& partition) override;
  void begin_step(double h, int substeps, int iterations) override;
  int phases() const override { return static_cast<int>(phase_start_.size()) - 1; }
  std::int64_t chunks(int phase) const override;
  std::int64_t project(int phase, std::int64_t chunk, const Sweep<Real>& sweep) override;
  void values(const Sweep<Real>& sweep, std::span<double> c) const override;
  void multipliers(std::span<double> lambda) const override;
  double energy(const Sweep<Real>& sweep) const override;

 private:
  using V = Vector<double>;
  static constexpr int kLanes = sizeof(V) / sizeof(double);
  // Up to kLanes clusters, and what is common to the particles of each.
  struct Batch {
    int count = 0;
    std::array<std::int32_t, kLanes> cluster{};
    std::array<double, kLanes> pinned_mass{};  // 0 where no particle is free
    Vector3<V> centre, rest_centre;
    Matrix3<V> T;
  };
  void match(const Sweep<Real>& sweep, Batch& batch) const;
  // C^2, its part of free particles, and C dC/dx . (x - x_old) of one cluster of the batch.
  std::array<double, 3> measure(const Sweep<Real>& sweep, const Batch& batch, int lane) const;
  // Calls visit(slot, mass, x - g, is free) for the members of a cluster of the batch.
  template <class Visit>
  void for_members(const Sweep<Real>& sweep, const Batch& batch, int lane, Visit&& visit) const;
  std::int64_t project_cluster(const Sweep<Real>& sweep, const Batch& batch, int lane);
  std::int64_t batches(int phase) const;

  Clusters clusters_;
  std::vector<std::int32_t> slot_;            // of each member
  std::vector<std::int32_t> order_;           // clusters, colour by colour
  std::vector<std::int64_t> phase_start_{0};  // of the colours in order_
  std::vector<double> lambda_, share_;        // share_: of a correction that is carried out
};

extern template class ShapeMatching<float>;
extern template class ShapeMatching<double>;

}  // namespace substep::pbd
