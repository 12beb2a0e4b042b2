#include "substep/ode/systems/oscillators.h"

#include <algorithm>
#include <utility>

#include "substep/core/parallel.h"
#include "substep/core/tableau.h"
#include "substep/ode/stepping/combine.h"
#include "substep/ode/symplectic/symplectic.h"

namespace substep::ode {
namespace {

constexpr std::int64_t kOscillatorsPerChunk = 16384;
constexpr std::int64_t kOscillatorsPerTile = 512;  // that stay in the first-level cache
constexpr std::int64_t kSweep = 64;                // steps while they are there

// The steps below are those of runge_kutta.h and symplectic.cpp, operation for operation, so they
// give the same bits. Each works on one oscillator; loops over tiles make vectors of them.

template <class T>
struct RungeKuttaStep {
  double h;
  void operator()(double& x, double& v, double minus_w2) const {
    double kx[T::stages][1], kv[T::stages][1];
    kx[0][0] = v;
    kv[0][0] = minus_w2 * x;
    stages<1>(kx, kv, x, v, minus_w2);
    x = increment<WeightRow<T>>(x, h, kx, 0);
    v = increment<WeightRow<T>>(v, h, kv, 0);
  }

 private:
  template <int S>
  void stages(double (*kx)[1], double (*kv)[1], double x, double v, double minus_w2) const {
    if constexpr (S < T::stages) {
      kv[S][0] = minus_w2 * increment<StageRow<T, S>>(x, h, kx, 0);
      kx[S][0] = increment<StageRow<T, S>>(v, h, kv, 0);
      stages<S + 1>(kx, kv, x, v, minus_w2);
    }
  }
};

struct SymplecticEulerStep {
  double h;
  void operator()(double& x, double& v, double minus_w2) const {
    v = multiply_add(h, minus_w2 * x, v);
    x = multiply_add(h, v, x);
  }
};

struct PositionVerletStep {  // d_n = x_n - x_{n-1} in the place of v
  double h;
  void operator()(double& x, double& d, double minus_w2) const {
    d = multiply_add(h * h, minus_w2 * x, d);
    x += d;
  }
};

template <int method>
struct VerletStep {
  double h;
  void operator()(double& x, double& v, double minus_w2) const {
    for (const double weight : verlet_weights(method)) {
      const double s = weight * h;
      v = multiply_add(s / 2, minus_w2 * x, v);
      x = multiply_add(s, v, x);
      v = multiply_add(s / 2, minus_w2 * x, v);
    }
  }
};

template <class Step>
void sweep(const Step step, std::int64_t n, std::int64_t steps, double* __restrict x,
           double* __restrict v, const double* __restrict minus_omega2) {
  for (std::int64_t s = 0; s < steps; ++s) {
    for (std::int64_t i = 0; i < n; ++i) {
      double xi = x[i], vi = v[i];
      step(xi, vi, minus_omega2[i]);
      x[i] = xi;
      v[i] = vi;
    }
  }
}

template <class Step>
void run_steps(const Step step, const FixedRun& run, const std::vector<double>& minus_omega2) {
  const auto n = static_cast<std::int64_t>(minus_omega2.size());
  double *x = run.y, *v = run.y + n;
  for (std::int64_t done = 0; done < run.steps; done += kSweep) {
    const std::int64_t steps = std::min(kSweep, run.steps - done);
    parallel_for(
        n, kOscillatorsPerChunk,
        [&](std::int64_t begin, std::int64_t end) {
          for (std::int64_t i = begin; i < end; i += kOscillatorsPerTile) {
            sweep(step, std::min(kOscillatorsPerTile, end - i), steps, x + i, v + i,
                  minus_omega2.data() + i);
          }
        },
        run.threads);
  }
}

}  // namespace

Oscillators::Oscillators(std::vector<double> omega) : minus_omega2_(std::move(omega)) {
  for (double& w : minus_omega2_) w *= -w;
}

std::int64_t Oscillators::size() const {
  return 2 * static_cast<std::int64_t>(minus_omega2_.size());
}

void Oscillators::rhs(double t, const double* y, double* dydt) {
  const std::int64_t n = size() / 2;
  std::copy(y + n, y + 2 * n, dydt);
  acceleration(t, y, y + n, dydt + n);
}

void Oscillators::acceleration(double, const double* x, const double*, double* a) {
  const double* minus_w2 = minus_omega2_.data();
  parallel_for(size() / 2, kOscillatorsPerChunk, [=](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) a[i] = minus_w2[i] * x[i];
  });
}

bool Oscillators::fixed_steps(const FixedRun& run) {
  const double h = run.h;
  bool done = false;
  for_each_method<FixedMethods>([&]<class T>(const T&) {
    if (run.method == T::name) run_steps(RungeKuttaStep<T>{h}, run, minus_omega2_), done = true;
  });
  if (done) return true;
  switch (symplectic_method(run.method)) {
    case kSymplecticEuler:
      run_steps(SymplecticEulerStep{h}, run, minus_omega2_);
      break;
    case kPositionVerlet:
      run_steps(PositionVerletStep{h}, run, minus_omega2_);
      break;
    case kVelocityVerlet:
      run_steps(VerletStep<kVelocityVerlet>{h}, run, minus_omega2_);
      break;
    case kYoshida4:
      run_steps(VerletStep<kYoshida4>{h}, run, minus_omega2_);
      break;
    default:
      return false;
  }
  if (run.a != nullptr) acceleration(0, run.y, nullptr, run.a);
  return true;
}

}  // namespace substep::ode
