// Newtonian gravity among n bodies by direct summation, softened after Plummer:
//
//   x_i'' = G sum_{j != i} m_j (x_j - x_i) / (|x_j - x_i|^2 + softening^2)^(3/2)
//
// Aarseth, "Gravitational N-Body Simulations", Cambridge 2003, eq. 1.1 and 2.7. Positions are one
// row of `dimension` numbers per body.
#pragma once

#include <vector>

#include "substep/ode/stepping/system.h"

namespace substep::ode {

class NBody final : public System {
 public:
  // dimension: 2 or 3.
  NBody(std::vector<double> masses, double G, double softening, int dimension);

  std::int64_t size() const override { return 2 * dimension_ * bodies(); }
  void rhs(double t, const double* y, double* dydt) override;
  bool second_order() const override { return true; }
  void acceleration(double t, const double* x, const double* v, double* a) override;

 private:
  std::int64_t bodies() const { return static_cast<std::int64_t>(gm_.size()); }

  std::vector<double> gm_;  // G m_j
  double softening2_;
  int dimension_;
};

}  // namespace substep::ode
