// n masses on a line, each joined to its neighbours by springs, displacements x_i from rest:
//
//   m_i x_i'' = k_{i+1} (x_{i+1} - x_i) - k_i (x_i - x_{i-1}),  i = 0 .. n-1
//
// Fixed ends: x_{-1} = x_n = 0 (walls); free ends: x_{-1} = x_0, x_n = x_{n-1}.
//
// Fixed steps run in overlapped tiles: a tile is copied with a halo of its neighbours' old values,
// several steps are done on the copy while it is in the cache (each application of the force
// spoils one cell of the halo), and the tile's own cells are written back. So memory is swept once
// for many steps, and no tile waits for another.
#pragma once

#include <vector>

#include "substep/ode/stepping/system.h"

namespace substep::ode {

class SpringChain final : public System {
 public:
  // k and m of one entry: the same for all; else n + 1 springs and n masses.
  SpringChain(std::int64_t n, std::vector<double> k, std::vector<double> m, bool fixed_ends);

  std::int64_t size() const override { return 2 * n_; }
  void rhs(double t, const double* y, double* dydt) override;
  bool second_order() const override { return true; }
  void acceleration(double t, const double* x, const double* v, double* a) override;
  bool fixed_steps(const FixedRun& run) override;
  bool polls() const override { return true; }

 private:
  template <class Use>
  auto with_force(Use&& use) const;

  std::int64_t n_;
  bool uniform_, fixed_ends_;
  double k_over_m_ = 0;                   // where uniform
  std::vector<double> k_, inverse_mass_;  // else
};

}  // namespace substep::ode
