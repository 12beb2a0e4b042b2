#include "substep/gridfluid/liquid/narrow_band.h"

#include <cmath>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {
namespace {

// each(i) for i from `begin` to below `end`.
template <class Each>
void for_numbers_from(std::int64_t begin, std::int64_t end, int threads, const Each& each) {
  for_numbers(end - begin, threads,
              [&](std::size_t k) { each(static_cast<std::int64_t>(k) + begin); });
}

// Numbers from 0 to below 1, number k of a sequence that fills a cube evenly however many of them
// are taken: multiples of the powers of 1/g, where g^(D + 1) = g + 1 (Roberts, "The unreasonable
// effectiveness of quasirandom sequences", 2018).
template <class Real, int D>
std::array<Real, D> spread_evenly(std::uint64_t k) {
  constexpr double g = D == 2 ? 1.32471795724474602596 : 1.22074408460575947536;
  std::array<Real, D> out;
  double power = 1;
  for (Real& x : out) {
    power /= g;
    const std::uint64_t whole = k * static_cast<std::uint64_t>(std::ldexp(power, 64));
    x = std::ldexp(static_cast<Real>(whole >> 40), -24);
  }
  return out;
}

}  // namespace

template <class Real, int D>
NarrowBand<Real, D>::NarrowBand(const Layout<D>& layout, const OpenSides<D>& open)
    : layout_(layout), open_(open), paths_(layout) {
  for (Flags* flags : {&deep_, &new_deep_, &edge_, &scratch_})
    assign(*flags, layout.size, std::uint8_t{0});
  for (auto* fields : {&u_, &new_u_}) {
    for (Field& field : *fields) assign(field, layout.size, Real(0));
  }
  for (Field& field : parts_) assign(field, layout.size, Real(0));
}

template <class Real, int D>
std::int64_t NarrowBand<Real, D>::count(const Flags& flags) const {
  std::int64_t sum = 0;
  layout_.for_cells([&](std::int64_t i) { sum += flags[usize(i)]; });
  return sum;
}

// Closed sides mirror; beyond open ones nothing is deep.
template <class Real, int D>
void NarrowBand<Real, D>::fill_ghosts_of(Flags& flags, int axis, int threads) const {
  fill_ghosts(layout_, kCentres, axis, flags.data(), threads);
  for (int side = 0; side < 2; ++side) {
    if (!open_[usize(axis)][usize(side)]) continue;
    for_side(layout_, axis, side,
             [&](std::int64_t, std::int64_t out, std::int64_t) { flags[usize(out)] = 0; });
  }
}

template <class Real, int D>
void NarrowBand<Real, D>::erode(Flags& flags, int times, int threads) {
  for (int t = 0; t < times; ++t) {
    for (int a = 0; a < D; ++a) {
      const std::int64_t s = layout_.stride[usize(a)];
      fill_ghosts_of(flags, a, threads);
      const std::uint8_t* const from = flags.data();
      std::uint8_t* const to = scratch_.data();
      for_numbers_from(s, layout_.size - s, threads,
                       [&](std::int64_t i) { to[i] = from[i - s] & from[i] & from[i + s]; });
      flags.swap(scratch_);
    }
  }
  for (int a = 0; a < D; ++a) fill_ghosts_of(flags, a, threads);
}

// The part of a particle's kernel, around each cell or face, that is in deep cells: of the mean of
// a cell along an axis 3/4 are at its middle and 1/8 at those beside it, and half at its faces.
template <class Real, int D>
const AlignedBuffer<Real>& NarrowBand<Real, D>::part(int component, const Flags& deep,
                                                     int threads) {
  copy(deep, parts_[0], threads);
  for (int a = 0; a < D; ++a) {
    const std::int64_t s = layout_.stride[usize(a)];
    const Real* const from = parts_[0].data();
    Real* const to = parts_[1].data();
    if (a == component) {
      for_numbers_from(s, layout_.size, threads,
                       [&](std::int64_t i) { to[i] = (from[i - s] + from[i]) / 2; });
    } else {
      for_numbers_from(s, layout_.size - s, threads, [&](std::int64_t i) {
        to[i] = Real(0.75) * from[i] + Real(0.125) * (from[i - s] + from[i + s]);
      });
    }
    parts_[0].swap(parts_[1]);
  }
  return parts_[0];
}

template <class Real, int D>
void NarrowBand<Real, D>::add_density(Real* density, int threads) {
  const Field& full = part(kCentres, deep_, threads);
  for_numbers(layout_.size, threads, [&](std::size_t i) { density[i] += full[i]; });
  fill_ghosts(layout_, kCentres, density, threads);
}

template <class Real, int D>
void NarrowBand<Real, D>::add_velocity(Real particles, const Faces<Real, D>& u,
                                       const Faces<Real, D>& weight, int threads) {
  for (int a = 0; a < D; ++a) {
    const Field &full = part(a, deep_, threads), &own = u_[usize(a)];
    Real *const velocity = u[usize(a)], *const w = weight[usize(a)];
    for_numbers(layout_.size, threads, [&](std::size_t i) {
      const Real more = particles * full[i], sum = w[i] + more;
      velocity[i] = more > 0 ? (w[i] * velocity[i] + more * own[i]) / sum : velocity[i];
      w[i] = sum;
    });
    fill_ghosts(layout_, a, velocity, threads);
    fill_ghosts(layout_, a, w, threads);
  }
}

// What a cell at the edge lacks of a density of 1 is passed on from cell to cell until it makes a
// particle, so that no row of them lacks more than one; a step sets right as much of it as
// keep_volume does elsewhere. What chance has taken or given in all comes back slowly, in all full
// cells of the band.
template <class Real, int D>
void NarrowBand<Real, D>::find_edge(const Particles<Real, D>& particles, const Real* density,
                                    const Real* phi, int threads) {
  constexpr Real kShare = 0.2, kBack = 0.02;
  const Field& part_deep = part(kCentres, deep_, threads);
  const std::int32_t* const first = particles.first();
  excess_.clear();
  drawn_.clear();
  new_seeded_ = seeded;
  std::int64_t full = 0;
  layout_.for_cells([&](std::int64_t i) { full += deep_[usize(i)] == 0 && phi[i] < -1; });
  const Real back =
      kBack * static_cast<Real>(missing) / static_cast<Real>(std::max<std::int64_t>(full, 1));
  Real lack = spread_evenly<Real, D>(static_cast<std::uint64_t>(new_seeded_++))[0] - Real(0.5);
  layout_.for_cells([&](std::int64_t i) {
    const bool inside = deep_[usize(i)] == 0 && phi[i] < -1;
    edge_[usize(i)] = inside && part_deep[usize(i)] > 0;
    if (!inside) return;
    lack += back;
    if (edge_[usize(i)] != 0) lack += kShare * (1 << D) * (1 - density[i]);
    if (lack > Real(0.5)) {
      draw(i, {}, Real(1));
      lack -= 1;
    } else if (lack < Real(-0.5) && first[i] < first[i + 1]) {
      excess_.push_back(first[i] + new_seeded_++ % (first[i + 1] - first[i]));
      lack += 1;
    }
  });
}

// A place for a particle in a part of a cell.
template <class Real, int D>
void NarrowBand<Real, D>::draw(std::int64_t cell, const std::array<Real, D>& low, Real size) {
  const std::array<int, D> at = layout_.cell(cell);
  const auto way = spread_evenly<Real, D>(static_cast<std::uint64_t>(new_seeded_++));
  for (std::size_t a = 0; a < D; ++a) {
    drawn_.push_back(static_cast<Real>(at[a]) + low[a] + size * way[a]);
  }
}

template <class Real, int D>
void NarrowBand<Real, D>::find_deep(Flags& liquid, int cells, int threads) {
  erode(liquid, cells, threads);
  new_deep_.swap(liquid);
}

template <class Real, int D>
Particles<Real, D> NarrowBand<Real, D>::collar(int cells, bool affine, int threads) {
  Flags far = new_deep_;
  erode(far, cells, threads);
  layout_.for_cells([&](std::int64_t i) {
    if (deep_[usize(i)] == 0 || far[usize(i)] != 0) return;
    for (unsigned part = 0; part < 1U << D; ++part) {  // of the cell's halves along each axis
      std::array<Real, D> low;
      for (std::size_t a = 0; a < D; ++a) low[a] = static_cast<Real>(part >> a & 1U) / 2;
      draw(i, low, Real(0.5));
    }
  });
  const std::size_t n = drawn_.size() / D;
  const std::vector<Real> v(drawn_.size());
  const std::vector<std::int64_t> ids(n);
  Particles<Real, D> out(affine);
  out.append(static_cast<std::int64_t>(n), drawn_.data(), v.data(), nullptr, ids.data());
  return out;
}

template <class Real, int D>
void NarrowBand<Real, D>::advect(const Velocity<Real, D>& u, double reach, int threads) {
  paths_.follow(u, reach, true, threads);
  for (int a = 0; a < D; ++a) {
    Field& to = new_u_[usize(a)];
    paths_.advect(
        a, all_faces(layout_, usize(a)), u[usize(a)], {to.data(), to.size()},
        [&](std::span<Real> x) { fill_ghosts(layout_, a, x.data(), threads); }, threads);
    const Field& full = part(a, new_deep_, threads);
    for_numbers(layout_.size, threads,
                [&](std::size_t i) { to[i] = full[i] > 0 ? to[i] : Real(0); });
    fill_ghosts(layout_, a, to.data(), threads);
  }
}

template <class Real, int D>
void NarrowBand<Real, D>::account(std::int64_t came, std::int64_t gone) {
  new_missing_ = missing + gone - came - (count(new_deep_) - count(deep_)) * (1 << D);
}

template <class Real, int D>
void NarrowBand<Real, D>::commit() noexcept {
  deep_.swap(new_deep_);
  u_.swap(new_u_);
  seeded = new_seeded_;
  missing = new_missing_;
}

// each(axis, face), row by row.
template <class Real, int D>
template <class Each>
void NarrowBand<Real, D>::for_faces(const Each& each) const {
  for (std::size_t a = 0; a < D; ++a) {
    for_rows(layout_, all_faces(layout_, a), 1, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) each(a, usize(i));
    });
  }
}

template <class Real, int D>
void NarrowBand<Real, D>::save(std::vector<std::uint8_t>& deep, std::vector<Real>& velocity) const {
  layout_.for_cells([&](std::int64_t i) { deep.push_back(deep_[usize(i)]); });
  for_faces([&](std::size_t a, std::size_t i) { velocity.push_back(u_[a][i]); });
}

template <class Real, int D>
void NarrowBand<Real, D>::restore(std::span<const std::uint8_t> deep,
                                  std::span<const Real> velocity) {
  std::size_t k = 0;
  layout_.for_cells([&](std::int64_t i) { deep_[usize(i)] = deep[k++]; });
  for (int a = 0; a < D; ++a) fill_ghosts_of(deep_, a, 1);
  k = 0;
  for_faces([&](std::size_t a, std::size_t i) { u_[a][i] = velocity[k++]; });
  for (int a = 0; a < D; ++a) fill_ghosts(layout_, a, u_[usize(a)].data());
}

template class NarrowBand<float, 2>;
template class NarrowBand<float, 3>;
template class NarrowBand<double, 2>;
template class NarrowBand<double, 3>;

}  // namespace substep::gridfluid
