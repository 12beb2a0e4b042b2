#include "substep/gridfluid/particles/density.h"

#include "substep/gridfluid/particles/row_sums.h"
#include "substep/gridfluid/particles/slabs.h"

namespace substep::gridfluid {
namespace {

template <class Real, int D>
class CentreSums {
 public:
  CentreSums(const Particles<Real, D>& particles, const Layout<D>& layout)
      : particles_(particles), layout_(layout) {
    sums_.reset(kCentres, layout.row_length());
  }

  void add_slab(std::int64_t slab, Real* density) {
    const auto x = positions(particles_);
    for_rows_of_slab(particles_, layout_, slab,
                     [&](std::int64_t row, const auto& across, std::int32_t p0, std::int32_t p1) {
                       int k0 = 0, k1 = 0;
                       for (std::int32_t p = p0; p < p1; p += Weights::kParticles) {
                         const int count = std::min(Weights::kParticles, p1 - p);
                         weights_.set(x, p, count, across, layout_.row_length());
                         for (int i = 0; i < count; ++i) add(usize(i));
                         if (p == p0) k0 = static_cast<int>(weights_.cell[0]);
                         k1 = static_cast<int>(weights_.cell[usize(count - 1)]);
                       }
                       sums_.add_to(layout_, row, k0, k1, {density});
                     });
  }

 private:
  using Sums = RowSums<Real, D, D, 1>;
  using Weights = RowWeights<Real, D>;
  using Nodes = NodeLanes<Real, D>;

  SUBSTEP_INLINE void add(std::size_t p) {
    using V = typename Nodes::V;
    std::int64_t at = weights_.cell[p] * Sums::kCell;
    for (int d = 0; d < D; ++d) {
      at += weights_.upper[usize(d)][p] * (Sums::kQuadrant << Sums::shift_bit(kCentres, d));
    }
    for (int part = 0; part < Nodes::kParts; ++part) {
      Real* const to = sums_.data() + at + part * Nodes::kLanes;
      V w = Nodes::weight(Nodes::upper(part, 0), weights_.h[0][p]);
      for (int d = 1; d < D; ++d) {
        w *= Nodes::weight(Nodes::upper(part, d), weights_.h[usize(d)][p]);
      }
      w += load<V>(to);
      std::memcpy(to, &w, sizeof w);
    }
  }

  const Particles<Real, D>& particles_;
  const Layout<D>& layout_;
  Sums sums_;
  Weights weights_;
};

}  // namespace

template <class Real, int D>
void number_density(const Particles<Real, D>& particles, const Layout<D>& layout, Real rest,
                    Real* density, int threads) {
  add_by_slabs(
      layout, 1,
      [&](std::int64_t begin, std::int64_t end) { std::fill(density + begin, density + end, 0); },
      [&](std::int64_t slab) { CentreSums<Real, D>(particles, layout).add_slab(slab, density); },
      [&](int) { fold_ghosts(layout, kCentres, density); },
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) density[i] *= 1 / rest;
      },
      [&](int) { fill_ghosts(layout, kCentres, density); }, threads);
}

template void number_density(const Particles<float, 2>&, const Layout<2>&, float, float*, int);
template void number_density(const Particles<float, 3>&, const Layout<3>&, float, float*, int);
template void number_density(const Particles<double, 2>&, const Layout<2>&, double, double*, int);
template void number_density(const Particles<double, 3>&, const Layout<3>&, double, double*, int);

}  // namespace substep::gridfluid
