// A step of the explicit Runge-Kutta method of third order of Shu and Osher, "Efficient
// implementation of essentially non-oscillatory shock-capturing schemes", 1988, for arrays that
// change together: by what is computed of them, and by what stays the same in all stages. Where the
// sum of both is 0 it changes nothing, whatever the step.
#pragma once

#include <span>
#include <vector>

#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {

template <class Real, int D>
struct Changing {
  Block<D> block;
  std::span<const Real> from;   // at the beginning of the step
  std::span<const Real> given;  // change that is the same in all stages
  std::span<Real> stage;        // as `from` at first, with ghosts
  std::span<Real> change;       // what comes out
};

// rate(k, out) computes how fast array k changes of all stages; prepare(k, d) makes a change ready
// to be added to a stage, ghost cells of which refill(k, x) fills then.
template <class Real, int D, class Rate, class Prepare, class Refill>
void runge_kutta(const Layout<D>& layout, std::span<const Changing<Real, D>> arrays, Real h,
                 std::span<Real> rates, const Rate& rate, const Prepare& prepare,
                 const Refill& refill, int threads) {
  const auto each = [&](const Changing<Real, D>& x, const auto& put) {
    for_rows(layout, x.block, threads, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) put(usize(i));
    });
  };
  const auto go_on = [&](Real changes, Real givens) {
    for (std::size_t k = 0; k < arrays.size(); ++k) {
      const Changing<Real, D>& x = arrays[k];
      each(x, [&](std::size_t i) { x.stage[i] = changes * x.change[i] + givens * x.given[i]; });
      prepare(k, x.stage);
      each(x, [&](std::size_t i) { x.stage[i] += x.from[i]; });
      refill(k, x.stage);
    }
  };
  for (std::size_t k = 0; k < arrays.size(); ++k) {
    const Changing<Real, D>& x = arrays[k];
    rate(k, rates);
    each(x, [&](std::size_t i) { x.change[i] = h * rates[i]; });
  }
  go_on(Real(1), Real(1));
  for (std::size_t k = 0; k < arrays.size(); ++k) {
    const Changing<Real, D>& x = arrays[k];
    rate(k, rates);
    each(x, [&](std::size_t i) { x.change[i] += h * rates[i]; });
  }
  go_on(Real(0.25), Real(0.5));
  for (std::size_t k = 0; k < arrays.size(); ++k) {
    const Changing<Real, D>& x = arrays[k];
    rate(k, rates);
    each(x, [&](std::size_t i) {
      x.change[i] = x.change[i] / 6 + Real(2.0 / 3) * h * rates[i] + x.given[i];
    });
  }
}

}  // namespace substep::gridfluid
