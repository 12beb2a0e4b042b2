#include "substep/ode/symplectic/symplectic.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/ode/stepping/combine.h"

namespace substep::ode {
namespace {

constexpr std::int64_t kGrain = 16384;  // components per chunk

}  // namespace

int symplectic_method(std::string_view name) {
  for (std::size_t i = 0; i < kSymplecticMethods.size(); ++i) {
    if (kSymplecticMethods[i].name == name) return static_cast<int>(i);
  }
  return -1;
}

SymplecticStepper::SymplecticStepper(System& system, int method, const double* x0, const double* v0,
                                     int threads)
    : system_(system), method_(method), threads_(threads), n_(system.size() / 2) {
  const auto n = usize(n_);
  state.y.resize(2 * n);
  state.a.resize(n);
  w_.resize(n);
  if (method == kPositionVerlet) state.d.resize(n);
  std::copy(x0, x0 + n_, state.y.data());
  std::copy(v0, v0 + n_, state.y.data() + n_);
}

template <class Task>
void SymplecticStepper::for_components(Task&& task) const {
  if (n_ <= kGrain) return task(std::int64_t{0}, n_);
  parallel_for(n_, kGrain, task, threads_);
}

void SymplecticStepper::evaluate(double t, const double* velocity, int stage) {
  double* a = state.a.data();
  system_.acceleration(t, x(), velocity, a);
  ++evaluations;
  if (all_finite(a, n_)) return;
  const auto index = std::find_if(a, a + n_, [](double ai) { return !std::isfinite(ai); }) - a;
  throw NonFiniteError("the acceleration became NaN or infinite at stage " + std::to_string(stage),
                       t, index);
}

void SymplecticStepper::begin_increments(double h) {
  if (h == state.d_step) return;
  const double half = h * h / 2;
  for (std::int64_t i = 0; i < n_; ++i) state.d[i] = multiply_add(-half, a()[i], h * v()[i]);
  state.d_step = h;
}

void SymplecticStepper::step(double t, double h) {
  double *x = state.y.data(), *v = x + n_, *d = state.d.data(), *w = w_.data();
  const double* a = state.a.data();
  if (method_ == kSymplecticEuler) {
    for_components([=](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        v[i] = multiply_add(h, a[i], v[i]);
        x[i] = multiply_add(h, v[i], x[i]);
      }
    });
    return evaluate(t + h, v, 1);
  }
  if (method_ == kPositionVerlet) {
    begin_increments(h);
    const double hh = h * h, inverse = 1 / h;
    for_components([=](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        d[i] = multiply_add(hh, a[i], d[i]);
        x[i] += d[i];
        w[i] = multiply_add(hh / 2, a[i], d[i]) * inverse;
      }
    });
    evaluate(t + h, w, 1);
    return for_components([=](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) v[i] = multiply_add(hh / 2, a[i], d[i]) * inverse;
    });
  }
  int stage = 0;
  for (const double weight : verlet_weights(method_)) {
    const double s = weight * h;
    for_components([=](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        v[i] = multiply_add(s / 2, a[i], v[i]);
        x[i] = multiply_add(s, v[i], x[i]);
        w[i] = multiply_add(s / 2, a[i], v[i]);
      }
    });
    t += s;
    evaluate(t, w, ++stage);
    for_components([=](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) v[i] = multiply_add(s / 2, a[i], v[i]);
    });
  }
}

bool SymplecticStepper::run(double t0, double h, std::int64_t first, std::int64_t steps) {
  const SymplecticMethod& method = kSymplecticMethods[usize(method_)];
  double* v = state.y.data() + n_;
  const bool increments = method_ == kPositionVerlet;
  if (increments) {
    begin_increments(h);
    std::swap_ranges(state.d.begin(), state.d.end(), v);
  }
  const bool done = system_.fixed_steps({.method = method.name,
                                         .t = t0,
                                         .h = h,
                                         .steps = steps,
                                         .y = state.y.data(),
                                         .threads = threads_,
                                         .first = first,
                                         .a = state.a.data()});
  if (increments) std::swap_ranges(state.d.begin(), state.d.end(), v);
  if (!done) return false;
  evaluations += steps * method.evaluations;
  if (increments) {
    const double hh = h * h, inverse = 1 / h;
    for (std::int64_t i = 0; i < n_; ++i) {
      v[i] = multiply_add(hh / 2, a()[i], state.d[i]) * inverse;
    }
  }
  return true;
}

bool SymplecticStepper::finite() const {
  return all_finite(state.y.data(), 2 * n_) && all_finite(a(), n_);
}

}  // namespace substep::ode
