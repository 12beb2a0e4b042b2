// The particles of a fluid, in an order of their own (that of the cells of the last step).
#pragma once

#include <cstdint>
#include <vector>

#include "substep/core/point.h"
#include "substep/core/reserve.h"
#include "substep/core/usize.h"

namespace substep::pbf {

template <class Real>
struct Particles {
  std::vector<Point<Real>> x;    // position from the origin [m], inverse mass m_0 / m
  std::vector<Point<Real>> v;    // velocity [m/s], multiplier of the last step [m^2]
  std::vector<Point<Real>> f;    // external force [N] of the next step; empty where there is none
  std::vector<std::int64_t> id;  // in the order they came to be
  std::vector<std::int32_t> fluid;  // which of the fluids

  std::int64_t size() const { return static_cast<std::int64_t>(id.size()); }

  // Where it throws, nothing has changed.
  void resize(std::int64_t n, bool forces) {
    const auto count = usize(n);
    reserve_amortised(x, count);
    reserve_amortised(v, count);
    if (forces) reserve_amortised(f, count);
    reserve_amortised(id, count);
    reserve_amortised(fluid, count);
    x.resize(count);
    v.resize(count);
    f.resize(forces ? count : 0);
    id.resize(count);
    fluid.resize(count);
  }

  // Row `to` becomes row `from` of others.
  void copy_row(std::int64_t to, const Particles& others, std::int64_t from) {
    const auto i = usize(to), j = usize(from);
    x[i] = others.x[j];
    v[i] = others.v[j];
    if (!f.empty()) f[i] = others.f[j];
    id[i] = others.id[j];
    fluid[i] = others.fluid[j];
  }

  // Drops the rows where flags are set; the others keep their order.
  void erase(const std::vector<std::uint8_t>& flags) {
    std::int64_t kept = 0;
    for (std::int64_t i = 0; i < size(); ++i) {
      if (flags[usize(i)] == 0) copy_row(kept++, *this, i);
    }
    resize(kept, !f.empty());
  }
};

}  // namespace substep::pbf
