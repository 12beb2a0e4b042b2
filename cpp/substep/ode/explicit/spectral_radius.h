// An upper bound of the spectral radius of df/dy, from which RKC2 takes its number of stages: given
// by the user, known to the system, or estimated by a nonlinear power method.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "substep/ode/stepping/system.h"

namespace substep::ode {

class SpectralRadius {
 public:
  using Given = std::function<double(double t, const double* y)>;

  // Rates below 1 / span are as good as zero. An estimate serves so many steps, or until one is
  // rejected.
  SpectralRadius(System& system, Given given, double span, std::int64_t steps_of_estimate)
      : system_(system),
        given_(std::move(given)),
        slowest_(1.0 / span),
        steps_of_estimate_(steps_of_estimate) {}

  // At (t, y) with f = f(t, y) before step number `step`. A given or known bound is asked for at
  // every new t.
  double at(double t, const double* y, const double* f, std::int64_t step);
  double value() const { return value_; }  // as found last
  void step_rejected() { stale_ = true; }

  std::int64_t evaluations() const { return evaluations_; }  // of f

 private:
  double estimate(double t, const double* y, const double* f);
  void choose_direction(const double* f);

  System& system_;
  Given given_;
  double slowest_;
  std::int64_t steps_of_estimate_;
  double value_ = 0.0, time_ = 0.0;
  std::int64_t step_ = -1;  // for which value_ was found
  bool stale_ = false;
  std::int64_t evaluations_ = 0, estimates_ = 0;
  std::vector<double> direction_, v_, f_v_;  // of v - y, of length 1; v; f(v)
};

}  // namespace substep::ode
