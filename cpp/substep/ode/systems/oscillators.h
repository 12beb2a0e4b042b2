// n independent harmonic oscillators x_i'' = -omega_i^2 x_i. Each needs nobody else, so the fixed
// steps run with all stages in registers, and many steps while a tile is in the cache.
#pragma once

#include <vector>

#include "substep/ode/stepping/system.h"

namespace substep::ode {

class Oscillators final : public System {
 public:
  explicit Oscillators(std::vector<double> omega);

  std::int64_t size() const override;
  void rhs(double t, const double* y, double* dydt) override;
  bool second_order() const override { return true; }
  void acceleration(double t, const double* x, const double* v, double* a) override;
  bool fixed_steps(const FixedRun& run) override;
  bool polls() const override { return true; }

 private:
  std::vector<double> minus_omega2_;
};

}  // namespace substep::ode
