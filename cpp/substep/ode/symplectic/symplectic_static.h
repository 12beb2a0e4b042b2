// The fixed steps of symplectic.h for systems of D components whose acceleration can be inlined:
// the same operations as SymplecticStepper, so the same bits, with everything in registers.
#pragma once

#include "substep/ode/stepping/combine.h"
#include "substep/ode/symplectic/symplectic.h"

namespace substep::ode {

template <int D, class Acceleration>
class StaticSymplectic {
 public:
  StaticSymplectic(const FixedRun& run, const Acceleration& acceleration)
      : run_(run), acceleration_(acceleration) {
    for (int i = 0; i < D; ++i) x_[i] = run.y[i], v_[i] = run.y[D + i], a_[i] = run.a[i];
  }

  // False where the run's method is none of them.
  bool operator()() {
    switch (symplectic_method(run_.method)) {
      case kSymplecticEuler:
        steps([this](double t, double h) { symplectic_euler(t, h); });
        break;
      case kPositionVerlet:
        steps([this](double t, double h) { position_verlet(t, h); });
        break;
      case kVelocityVerlet:
        steps([this](double t, double h) { verlet<kVelocityVerlet>(t, h); });
        break;
      case kYoshida4:
        steps([this](double t, double h) { verlet<kYoshida4>(t, h); });
        break;
      default:
        return false;
    }
    for (int i = 0; i < D; ++i) run_.y[i] = x_[i], run_.y[D + i] = v_[i], run_.a[i] = a_[i];
    return true;
  }

 private:
  template <class Step>
  void steps(Step&& step) {
    for (std::int64_t k = 0; k < run_.steps; ++k) {
      step(run_.t + static_cast<double>(run_.first + k) * run_.h, run_.h);
    }
  }

  void symplectic_euler(double t, double h) {
    for (int i = 0; i < D; ++i) {
      v_[i] = multiply_add(h, a_[i], v_[i]);
      x_[i] = multiply_add(h, v_[i], x_[i]);
    }
    acceleration_(t + h, x_, v_, a_);
  }

  void position_verlet(double t, double h) {  // v_ holds the increments
    const double hh = h * h, inverse = 1 / h;
    double w[D];
    for (int i = 0; i < D; ++i) {
      v_[i] = multiply_add(hh, a_[i], v_[i]);
      x_[i] += v_[i];
      w[i] = multiply_add(hh / 2, a_[i], v_[i]) * inverse;
    }
    acceleration_(t + h, x_, w, a_);
  }

  template <int method>
  void verlet(double t, double h) {
    for (const double weight : verlet_weights(method)) {
      const double s = weight * h;
      double w[D];
      for (int i = 0; i < D; ++i) {
        v_[i] = multiply_add(s / 2, a_[i], v_[i]);
        x_[i] = multiply_add(s, v_[i], x_[i]);
        w[i] = multiply_add(s / 2, a_[i], v_[i]);
      }
      t += s;
      acceleration_(t, x_, w, a_);
      for (int i = 0; i < D; ++i) v_[i] = multiply_add(s / 2, a_[i], v_[i]);
    }
  }

  const FixedRun& run_;
  const Acceleration& acceleration_;
  double x_[D], v_[D], a_[D];
};

}  // namespace substep::ode
