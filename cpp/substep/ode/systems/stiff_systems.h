// The small classical stiff systems, with their Jacobians (J[j * N + i] = df_i/dy_j). Equations,
// symbols and sources stand in python/substep/ode/systems/stiff.py.
#pragma once

#include "substep/ode/systems/static_system.h"

namespace substep::ode {

class Robertson final : public StaticSystem<Robertson, 3> {
 public:
  Robertson(double k1, double k2, double k3) : k1_(k1), k2_(k2), k3_(k3) {}

  [[gnu::always_inline]] void eval(double, const double* y, double* dydt) const {
    const double slow = k1_ * y[0], back = k3_ * y[1] * y[2], fast = k2_ * y[1] * y[1];
    dydt[0] = back - slow;
    dydt[1] = slow - back - fast;
    dydt[2] = fast;
  }
  [[gnu::always_inline]] void eval_jacobian(double, const double* y, double* J) const {
    const double from_y2 = k3_ * y[2], from_y3 = k3_ * y[1], fast = 2.0 * k2_ * y[1];
    J[0] = -k1_, J[3] = from_y2, J[6] = from_y3;
    J[1] = k1_, J[4] = -from_y2 - fast, J[7] = -from_y3;
    J[2] = 0.0, J[5] = fast, J[8] = 0.0;
  }

 private:
  double k1_, k2_, k3_;
};

class Orego final : public StaticSystem<Orego, 3> {
 public:
  Orego(double s, double q, double w) : s_(s), q_(q), w_(w) {}

  [[gnu::always_inline]] void eval(double, const double* y, double* dydt) const {
    dydt[0] = s_ * (y[1] + y[0] * (1.0 - q_ * y[0] - y[1]));
    dydt[1] = (y[2] - (1.0 + y[0]) * y[1]) / s_;
    dydt[2] = w_ * (y[0] - y[2]);
  }
  [[gnu::always_inline]] void eval_jacobian(double, const double* y, double* J) const {
    J[0] = s_ * (1.0 - 2.0 * q_ * y[0] - y[1]), J[3] = s_ * (1.0 - y[0]), J[6] = 0.0;
    J[1] = -y[1] / s_, J[4] = -(1.0 + y[0]) / s_, J[7] = 1.0 / s_;
    J[2] = w_, J[5] = 0.0, J[8] = -w_;
  }

 private:
  double s_, q_, w_;
};

class Hires final : public StaticSystem<Hires, 8> {
 public:
  [[gnu::always_inline]] void eval(double, const double* y, double* dydt) const {
    const double bound = 280.0 * y[5] * y[7], released = 1.81 * y[6];
    dydt[0] = -1.71 * y[0] + 0.43 * y[1] + 8.32 * y[2] + 0.0007;
    dydt[1] = 1.71 * y[0] - 8.75 * y[1];
    dydt[2] = -10.03 * y[2] + 0.43 * y[3] + 0.035 * y[4];
    dydt[3] = 8.32 * y[1] + 1.71 * y[2] - 1.12 * y[3];
    dydt[4] = -1.745 * y[4] + 0.43 * y[5] + 0.43 * y[6];
    dydt[5] = -bound + 0.69 * y[3] + 1.71 * y[4] - 0.43 * y[5] + 0.69 * y[6];
    dydt[6] = bound - released;
    dydt[7] = released - bound;
  }
  void eval_jacobian(double, const double* y, double* J) const {
    for (int k = 0; k < 64; ++k) J[k] = 0.0;
    const auto at = [J](int i, int j) -> double& { return J[j * 8 + i]; };
    at(0, 0) = -1.71, at(0, 1) = 0.43, at(0, 2) = 8.32;
    at(1, 0) = 1.71, at(1, 1) = -8.75;
    at(2, 2) = -10.03, at(2, 3) = 0.43, at(2, 4) = 0.035;
    at(3, 1) = 8.32, at(3, 2) = 1.71, at(3, 3) = -1.12;
    at(4, 4) = -1.745, at(4, 5) = 0.43, at(4, 6) = 0.43;
    at(5, 3) = 0.69, at(5, 4) = 1.71, at(5, 5) = -280.0 * y[7] - 0.43, at(5, 6) = 0.69;
    at(5, 7) = -280.0 * y[5];
    at(6, 5) = 280.0 * y[7], at(6, 6) = -1.81, at(6, 7) = 280.0 * y[5];
    at(7, 5) = -280.0 * y[7], at(7, 6) = 1.81, at(7, 7) = -280.0 * y[5];
  }
};

extern template class StaticSystem<Robertson, 3>;
extern template class StaticSystem<Orego, 3>;
extern template class StaticSystem<Hires, 8>;

}  // namespace substep::ode
