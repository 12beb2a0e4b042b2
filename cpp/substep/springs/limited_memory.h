// Limited-memory BFGS (Nocedal and Wright, "Numerical Optimization", 2nd ed., algorithm 7.4): what
// the last steps s and the changes y of the gradient on them tell of the Hessian, on top of an
// inverse H_0 that is at hand, the factorization of an earlier Hessian. With pairs j = 1 ... m and
// rho_j = 1 / (y_j . s_j), H g is
//
//   q = g;           for j = m ... 1:  a_j = rho_j s_j . q,   q -= a_j y_j
//   r = H_0 q;       for j = 1 ... m:  b   = rho_j y_j . r,   r += (a_j - b) s_j
//
// which is positive definite where H_0 is and all y_j . s_j > 0: other pairs are left out.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "substep/springs/term.h"

namespace substep::springs {

class LimitedMemory {
 public:
  explicit LimitedMemory(std::size_t capacity) : capacity_(capacity) {}

  // Forgets all pairs but the `kept` newest.
  void forget(std::size_t kept = 0);
  // The step s = x - x_before, and y = g - g_before; the oldest pair goes when the memory is full.
  void add(Positions x_before, Positions x, Positions g_before, Positions g, int threads);
  // r <- H r, where solve(r) is r <- H_0 r.
  void multiply(std::span<Vec3> r, const std::function<void(std::span<double>)>& solve,
                int threads) const;

 private:
  struct Pair {
    std::vector<double> s, y;
    double rho;
  };
  std::size_t capacity_;
  std::vector<Pair> pairs_;  // the newest last
};

}  // namespace substep::springs
