// Velocities without compression: the part of them that would raise the density is taken away by a
// pressure, as in the divergence-free solver of Bender and Koschier ("Divergence-free smoothed
// particle hydrodynamics", 2015). With g_ij = V W'(r) n_ij, for all i
//   c_i(v) = sum_j (L_i g_ij) . (v_i - v_j) + G_iw . (v_i - v_w) <= a_i,
//   v' = v - M^-1 c'(v)^T lambda,   lambda_i >= 0,   lambda_i (c_i(v') - a_i) = 0
// where w stands for the walls and a_i = max(0, s - C_i) / dt lets particles of a lower density
// than s, those of a free surface, come together to it.
// Deviations:
// - L_i = M_i^-1, M_i = -sum_j g_ij (x_i - x_j)^T with the walls' part, which makes c exact where
//   velocities are linear (Bonet and Lok, "Variational and momentum preservation aspects of SPH",
//   1999); at free surfaces L_i = I. There, L = I everywhere: with few neighbours, shear then
//   counts as compression in part, and a projection in every step takes its energy away.
// - G_iw = n (n . L_i grad b_iw), n a wall's normal: what slides along it is not compressed.
// - Conjugate gradients, preconditioned by the diagonal, in place of Jacobi's iteration (directions
//   by Polak and Ribiere 1969, which begin anew by themselves where multipliers end at 0 or leave
//   it). A step is cut where a multiplier would fall below 0, and as long as is best along what is
//   left: so what a cut changes needs no product of its own.
// - A wall that yields adds G W G^T to what is solved, of rank 6, with its mobility W. The
//   preconditioner has it too, with the diagonal D: (D + G W G^T)^-1, by Woodbury's formula, of the
//   particles whose multipliers may change.
// The gradients of c are kept, by rows and by columns: 24 bytes a pair (float32), and an iteration
// is two products with a sparse matrix.
// c'^T is what it is for c: linear momentum is kept to rounding, and angular momentum where
// M_i L_i = I.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/matrix3.h"
#include "substep/core/usize.h"
#include "substep/pbf/bodies.h"
#include "substep/pbf/neighbourhood.h"
#include "substep/pbf/options.h"
#include "substep/pbf/symmetric.h"

namespace substep::pbf {

template <class Real>
class VelocityProjection {
 public:
  // Their rows (grad b_i, b_i) and parts of M_i.
  struct Walls {
    std::span<const Point<Real>> contributions;
    std::span<const Symmetric<Real>> moments;
  };

  // Finds L, for particles that are where they are now.
  void prepare(const Neighbourhood<Real>& near, const Walls& walls, double surface_density,
               double dt);
  const Symmetric<Real>& correction(std::int64_t i) const { return l_[usize(i)]; }

  // walls: the sum of G_iw over all walls, and in w that of G_iw . v_w. lambda: to begin with, then
  // what was found; n + 1 rows, the last 0. v: n + 1 rows; w is kept. Stops where the mean of what
  // is compressed in dt is below `tolerance`. bodies: those walls that yield, with the sum of their
  // G_iw in the rows; G_iw . v_w is there what it is with the lambda to begin with.
  ProjectionReport project(const Neighbourhood<Real>& near, std::span<const Point<Real>> walls,
                           std::span<const YieldingBody<Real>> bodies, double dt, double tolerance,
                           int max_iterations, std::span<Real> lambda, std::span<Point<Real>> v);

 private:
  void find_gradients(const Neighbourhood<Real>& near, std::span<const Point<Real>> walls,
                      std::span<const Real> lambda);
  void spread(std::span<const Real> lambda, const Neighbourhood<Real>& near);
  // From the sum over the neighbours of i.
  void set_u(std::int64_t i, Real inverse_mass, Real lambda, const Quad<Real>& sum) {
    const Quad<Real> all = inverse_mass * (sum + lambda * load_quad(own_[usize(i)]));
    u_[usize(i)] = {all[0], all[1], all[2], 0};
  }
  template <class Use>
  auto compress(std::span<const Point<Real>> v, const Neighbourhood<Real>& near,
                std::span<const Point<Real>> walls, const Use& use) const;

  std::vector<Symmetric<Real>> l_;  // n + 1 rows
  std::vector<Real> allowed_, inverse_diagonal_;
  // c' row by row and column by column: of the neighbours of i, in lanes, from begin_[i] on.
  std::vector<std::int64_t> begin_;
  std::vector<Vector3<Vector<Real>>> rows_;     // L_i g_ij
  std::vector<Vector3<Vector<Real>>> columns_;  // L_j g_ij
  std::vector<Point<Real>> own_;                // sum_j L_i g_ij + G_iw; w: sum_j w_j |L_i g_ij|^2
  std::vector<Point<Real>> u_;  // M^-1 c'^T of the multipliers or of their step; n + 1 rows
  std::vector<Real> r_, p_, step_, ap_;
  std::vector<Real> r_before_, pull_;  // where there are bodies
};

extern template class VelocityProjection<float>;
extern template class VelocityProjection<double>;

}  // namespace substep::pbf
