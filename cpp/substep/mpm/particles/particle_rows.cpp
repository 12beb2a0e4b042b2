#include "substep/mpm/particles/particle_rows.h"

#include <algorithm>
#include <cmath>

#include "substep/core/usize.h"

namespace substep::mpm {

template <class Real, int D>
void reserve(ParticleRows<Real, D>& rows, std::size_t n, std::size_t width) {
  rows.blocks.reserve(n);
  rows.state.reserve(n * width);
  rows.motion.reserve(n * ParticleGroup<Real, D>::kMotion);
  rows.volume.reserve(n);
  rows.ids.reserve(n);
}

template <class Real, int D>
void append(ParticleRows<Real, D>& rows, const ParticleRows<Real, D>& from, std::size_t i) {
  const auto copy = [&](const auto& source, auto& target) {
    const std::size_t width = source.size() / from.ids.size();
    const auto row = source.begin() + static_cast<std::ptrdiff_t>(i * width);
    target.insert(target.end(), row, row + static_cast<std::ptrdiff_t>(width));
  };
  copy(from.blocks, rows.blocks);
  copy(from.state, rows.state);
  copy(from.motion, rows.motion);
  copy(from.volume, rows.volume);
  copy(from.ids, rows.ids);
}

template <class Real, int D>
void keep(ParticleRows<Real, D>& rows, std::span<const std::uint8_t> stays) {
  const std::size_t n = rows.ids.size();
  if (n == 0) return;
  const auto pack = [&](auto& column) {
    const std::size_t width = column.size() / n;
    auto to = column.begin();
    for (std::size_t i = 0; i < n; ++i) {
      if (stays[i] == 0) continue;
      to = std::copy_n(column.begin() + static_cast<std::ptrdiff_t>(i * width), width, to);
    }
    column.erase(to, column.end());
  };
  pack(rows.blocks);
  pack(rows.state);
  pack(rows.motion);
  pack(rows.volume);
  pack(rows.ids);
}

template <class Real, int D>
geometry::Vec3 position(const ParticleRows<Real, D>& rows, std::size_t i, double cell) {
  const Real* const in = rows.state.data() + i * (rows.state.size() / rows.ids.size());
  geometry::Vec3 x = geometry::Vec3::Zero();
  for (int d = 0; d < D; ++d) {
    const int block = rows.blocks[i][usize(d)];
    x[d] = cell * (static_cast<double>(transfer::kBlock) * block + static_cast<double>(in[d]));
  }
  return x;
}

template <class Real, int D>
void set_position(ParticleRows<Real, D>& rows, std::size_t i, double cell,
                  const geometry::Vec3& x) {
  Real* const in = rows.state.data() + i * (rows.state.size() / rows.ids.size());
  for (int d = 0; d < D; ++d) {
    const Place at = place(x[d] / cell);
    rows.blocks[i][usize(d)] = at.block;
    in[d] = static_cast<Real>(at.x);
  }
}

template <class Real, int D>
void place_again(ParticleRows<Real, D>& rows) {
  const std::size_t n = rows.ids.size(), width = n == 0 ? 0 : rows.state.size() / n;
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t d = 0; d < D; ++d) {
      Real& x = rows.state[i * width + d];
      const Place at = place(static_cast<double>(x));
      rows.blocks[i][d] += at.block;
      x = static_cast<Real>(at.x);
    }
  }
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                              \
  template void reserve(ParticleRows<Real, D>&, std::size_t, std::size_t);                        \
  template void append(ParticleRows<Real, D>&, const ParticleRows<Real, D>&, std::size_t);        \
  template void keep(ParticleRows<Real, D>&, std::span<const std::uint8_t>);                      \
  template geometry::Vec3 position(const ParticleRows<Real, D>&, std::size_t, double);            \
  template void set_position(ParticleRows<Real, D>&, std::size_t, double, const geometry::Vec3&); \
  template void place_again(ParticleRows<Real, D>&);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::mpm
