// The density constraint of position-based fluids (Macklin and Mueller, "Position based fluids",
// ACM Trans. Graph. 32(4), 2013), solved by Jacobi sweeps over lists of neighbours.
//
// Every particle stands for the same volume v, chosen so that an infinite lattice of the given
// spacing has density 1; fluids differ in their masses. In place of the paper's mass density this
// is the number density of Solenthaler and Pajarola ("Density contrast SPH interfaces", 2008, eq.
// 3), which stays exact across the interface of two fluids:
//   C_i = v sum_j W(|x_i - x_j|) + b_i - 1    (j = i included; b_i: what walls contribute),
//   grad_i C_i = v sum_j W' n_ij + grad b_i,   grad_j C_i = -v W' n_ij,   n_ij = (x_i - x_j) / r.
// With w = m_0 / m the inverse masses in units of a mass m_0 (eq. 11 of the paper has w = 1):
//   lambda_i = -C_i / (sum_k w_k |grad_k C_i|^2 + e S),
//   dx_i = w_i [v sum_j (lambda_i + lambda_j + s_ij) W' n_ij + lambda_i grad b_i]    (eq. 14).
// m_i dx_i is antisymmetric in i and j: without walls momentum is kept. Angular momentum is up to
// terms of the order of the step: dx lies along the lines between the particles at the end of the
// step, and becomes velocity where they were at its start.
//
// One-sided (the default), max(C_i, 0) takes the place of C_i: a free surface, where C < 0 for want
// of neighbours, is not pulled together.
// e is the relaxation relative to S, the sum of |grad_k C_i|^2 in the rest lattice (w = 1); as an
// XPBD constraint (Macklin et al., 2016) that is a compliance of e S / m_0, times the square of the
// step. s_ij is the artificial pressure -k / S (W(r) / W(0.2 h))^4 (their eq. 13): k is the density
// error that would push as hard in the rest lattice. |dx_i| is at most h / 4 in one sweep, which
// only particles that (nearly) coincide reach; momentum is not kept for those. They are counted.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/geometry/neighbours.h"
#include "substep/pbf/options.h"

namespace substep::pbf {

// C_i, and what divides it.
template <class Real>
struct DensityRow {
  Real violation, scale;
};

// Rows x hold in w the inverse mass, rows y the multiplier; both have one row more than there are
// particles, far_point(), for the padding of the lists. `walls` are rows of (grad b_i, b_i).
template <class Real>
class DensityConstraint {
 public:
  explicit DensityConstraint(const DensityOptions& options);

  double radius() const { return radius_; }  // h
  double volume() const { return volume_; }  // v
  double half_lattice() const {
    return half_lattice_;
  }  // density that a lattice adds from beyond
     // a plane half a spacing away
  double gradient_sum() const { return gradient_sum_; }  // S
  const DensityOptions& options() const { return options_; }
  // W(r) / W'(r), normalised.
  double value(double r) const;
  double slope(double r) const;
  // A row that is out of reach of all others.
  Point<Real> far_point() const;

  // C_i + 1, also where the constraint is one-sided.
  void densities(std::span<const Point<Real>> x, const geometry::Neighbours<Real>& neighbours,
                 std::span<const Point<Real>> walls, std::span<Real> out, int threads) const;
  // y_i = (x_i, lambda_i). What lambda_i is made of goes to `parts`, unless that is empty.
  DensityError multipliers(std::span<const Point<Real>> x,
                           const geometry::Neighbours<Real>& neighbours,
                           std::span<const Point<Real>> walls, std::span<Point<Real>> y,
                           int threads, std::span<DensityRow<Real>> parts = {}) const;
  // x_i = y_i + dx_i, where w of x is read and kept; the w of sums_i gets lambda_i more. Returns
  // how many reached the limit of |dx|.
  std::int64_t correct(std::span<const Point<Real>> y, const geometry::Neighbours<Real>& neighbours,
                       std::span<const Point<Real>> walls, std::span<Point<Real>> x,
                       std::span<Point<Real>> sums, int threads) const;

 private:
  template <class Visit>
  void for_kernel(Visit&& visit) const;

  DensityOptions options_;
  double radius_, power_, volume_, gradient_sum_, half_lattice_;
};

extern template class DensityConstraint<float>;
extern template class DensityConstraint<double>;

}  // namespace substep::pbf
