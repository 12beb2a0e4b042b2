// The small classical systems. Equations, symbols and sources stand in python/substep/systems.py.
#pragma once

#include <cmath>

#include "substep/ode/symplectic/symplectic_static.h"
#include "substep/ode/systems/static_system.h"

namespace substep::ode {

// A small system of the form x'' = a(t, x, v), y = [x, v]: Derived gives
// `void accelerate(double t, const double* x, const double* v, double* a) const`.
template <class Derived, int N>
class StaticSecondOrder : public StaticSystem<Derived, N> {
 public:
  static constexpr int kHalf = N / 2;

  bool second_order() const override { return true; }
  void acceleration(double t, const double* x, const double* v, double* a) override {
    static_cast<const Derived&>(*this).accelerate(t, x, v, a);
  }
  [[gnu::always_inline]] void eval(double t, const double* y, double* dydt) const {
    for (int i = 0; i < kHalf; ++i) dydt[i] = y[kHalf + i];
    static_cast<const Derived&>(*this).accelerate(t, y, y + kHalf, dydt + kHalf);
  }
  bool fixed_steps(const FixedRun& run) override {
    if (StaticSystem<Derived, N>::fixed_steps(run)) return true;
    if (run.a == nullptr) return false;
    const auto accelerate = [&](double t, const double* x, const double* v, double* a) {
      static_cast<const Derived&>(*this).accelerate(t, x, v, a);
    };
    return StaticSymplectic<kHalf, decltype(accelerate)>(run, accelerate)();
  }
};

class Lorenz final : public StaticSystem<Lorenz, 3> {
 public:
  Lorenz(double sigma, double rho, double beta) : sigma_(sigma), rho_(rho), beta_(beta) {}

  [[gnu::always_inline]] void eval(double, const double* y, double* dydt) const {
    dydt[0] = sigma_ * (y[1] - y[0]);
    dydt[1] = multiply_add(y[0], rho_ - y[2], -y[1]);
    dydt[2] = y[0] * y[1] - beta_ * y[2];
  }

 private:
  double sigma_, rho_, beta_;
};

// r^-3 of two bodies at (dx, dy), as r r^-4: the root and the quotient are computed side by side.
[[gnu::always_inline]] inline double inverse_cube(double dx, double dy) {
  const double r2 = dx * dx + dy * dy;
  return std::sqrt(r2) * (1.0 / (r2 * r2));
}

class Arenstorf final : public StaticSecondOrder<Arenstorf, 4> {
 public:
  explicit Arenstorf(double mu) : mu_(mu) {}

  [[gnu::always_inline]] void accelerate(double, const double* x, const double* v,
                                         double* a) const {
    const double rest = 1.0 - mu_;
    const double earth = rest * inverse_cube(x[0] + mu_, x[1]);
    const double moon = mu_ * inverse_cube(x[0] - rest, x[1]);
    a[0] = x[0] + 2.0 * v[1] - earth * (x[0] + mu_) - moon * (x[0] - rest);
    a[1] = x[1] - 2.0 * v[0] - earth * x[1] - moon * x[1];
  }

 private:
  double mu_;
};

class Kepler final : public StaticSecondOrder<Kepler, 4> {
 public:
  explicit Kepler(double mu) : mu_(mu) {}

  [[gnu::always_inline]] void accelerate(double, const double* x, const double*, double* a) const {
    const double pull = -mu_ * inverse_cube(x[0], x[1]);
    a[0] = pull * x[0];
    a[1] = pull * x[1];
  }

 private:
  double mu_;
};

class HenonHeiles final : public StaticSecondOrder<HenonHeiles, 4> {
 public:
  explicit HenonHeiles(double lambda) : lambda_(lambda) {}

  [[gnu::always_inline]] void accelerate(double, const double* x, const double*, double* a) const {
    a[0] = -x[0] - 2.0 * lambda_ * x[0] * x[1];
    a[1] = -x[1] - lambda_ * (x[0] * x[0] - x[1] * x[1]);
  }

 private:
  double lambda_;
};

class VanDerPol final : public StaticSecondOrder<VanDerPol, 2> {
 public:
  VanDerPol(double damping, double stiffness) : damping_(damping), stiffness_(stiffness) {}

  [[gnu::always_inline]] void accelerate(double, const double* x, const double* v,
                                         double* a) const {
    a[0] = damping_ * (1.0 - x[0] * x[0]) * v[0] - stiffness_ * x[0];
  }
  [[gnu::always_inline]] void eval_jacobian(double, const double* y, double* J) const {
    J[0] = 0.0, J[2] = 1.0;
    J[1] = -2.0 * damping_ * y[0] * y[1] - stiffness_, J[3] = damping_ * (1.0 - y[0] * y[0]);
  }

 private:
  double damping_, stiffness_;
};

class Pendulum final : public StaticSecondOrder<Pendulum, 2> {
 public:
  Pendulum(double length, double gravity, double damping)
      : omega2_(gravity / length), damping_(damping) {}

  void accelerate(double, const double* x, const double* v, double* a) const {
    a[0] = -omega2_ * std::sin(x[0]) - damping_ * v[0];
  }

 private:
  double omega2_, damping_;
};

class HarmonicOscillator final : public StaticSecondOrder<HarmonicOscillator, 2> {
 public:
  HarmonicOscillator(double omega, double damping) : omega2_(omega * omega), damping_(damping) {}

  [[gnu::always_inline]] void accelerate(double, const double* x, const double* v,
                                         double* a) const {
    a[0] = -omega2_ * x[0] - damping_ * v[0];
  }

 private:
  double omega2_, damping_;
};

// Seven bodies in the plane, y = [x_1..x_7, y_1..y_7, x'_1..x'_7, y'_1..y'_7].
class Pleiades final : public StaticSecondOrder<Pleiades, 28> {
 public:
  explicit Pleiades(const double* masses);

  void accelerate(double t, const double* x, const double* v, double* a) const;

 private:
  double mass_[11];  // periodic
};

extern template class StaticSystem<Lorenz, 3>;
extern template class StaticSystem<Arenstorf, 4>;
extern template class StaticSystem<Kepler, 4>;
extern template class StaticSystem<HenonHeiles, 4>;
extern template class StaticSystem<VanDerPol, 2>;
extern template class StaticSystem<Pendulum, 2>;
extern template class StaticSystem<HarmonicOscillator, 2>;
extern template class StaticSystem<Pleiades, 28>;

}  // namespace substep::ode
