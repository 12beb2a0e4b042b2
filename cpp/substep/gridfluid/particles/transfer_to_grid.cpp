#include "substep/gridfluid/particles/transfer_to_grid.h"

#include <algorithm>
#include <cstring>

#include "substep/gridfluid/particles/row_sums.h"
#include "substep/gridfluid/particles/slabs.h"

namespace substep::gridfluid {
namespace {

template <class Real, int D, bool kAffine>
class FaceSums {
 public:
  FaceSums(const Particles<Real, D>& particles, const Layout<D>& layout, Real dx)
      : particles_(particles), layout_(layout), dx_(dx) {
    for (int c = 0; c < D; ++c) sums_[usize(c)].reset(c, layout.row_length());
  }

  void add_slab(std::int64_t slab, const Faces<Real, D>& u, const Faces<Real, D>& weight) {
    const auto x = positions(particles_);
    for_rows_of_slab(particles_, layout_, slab,
                     [&](std::int64_t row, const auto& cross, std::int32_t p0, std::int32_t p1) {
                       int k0 = 0, k1 = 0;
                       for (std::int32_t p = p0; p < p1; p += Weights::kParticles) {
                         const int count = std::min(Weights::kParticles, p1 - p);
                         weights_.set(x, p, count, cross, layout_.row_length());
                         prepare(p, count);
                         for (int i = 0; i < count; ++i) add(usize(i));
                         if (p == p0) k0 = static_cast<int>(weights_.cell[0]);
                         k1 = static_cast<int>(weights_.cell[usize(count - 1)]);
                       }
                       for (std::size_t c = 0; c < D; ++c) {
                         sums_[c].add_to(layout_, row, k0, k1, {u[c], weight[c]});
                       }
                     });
  }

 private:
  using Sums = RowSums<Real, D, D - 1, 2>;
  using Weights = RowWeights<Real, D>;
  using Nodes = NodeLanes<Real, D>;
  using Numbers = typename Weights::template Numbers<Real>;

  // Velocities at the lowest node of each component, v + C (x_0 - x_p), what they grow by to the
  // next node along each axis, C dx, and where the sums are.
  void prepare(std::int64_t begin, int count) {
    using V = Vector<Real>;
    using I = Vector<IntOf<Real>>;
    constexpr int kLanes = kVectorBytes / static_cast<int>(sizeof(Real));
    for (std::size_t p = 0; p < usize(count); p += kLanes) {
      for (int c = 0; c < D; ++c) {
        V lowest = load<V>(particles_.v(c) + begin + p);
        I at = load<I>(&weights_.cell[p]) * Sums::kCell;
        for (int d = 0; d < D; ++d) {
          if constexpr (kAffine) {
            const V growth = load<V>(particles_.C(c, d) + begin + p) * dx_;
            const V way = load<V>(&(d == c ? weights_.f : weights_.h)[usize(d)][p]);
            lowest -= growth * way;
            std::memcpy(&growth_[usize(c)][usize(d)][p], &growth, sizeof growth);
          }
          if (d != c) {
            at +=
                load<I>(&weights_.upper[usize(d)][p]) * (Sums::kQuadrant << Sums::shift_bit(c, d));
          }
        }
        std::memcpy(&lowest_[usize(c)][p], &lowest, sizeof lowest);
        std::memcpy(&at_[usize(c)][p], &at, sizeof at);
      }
    }
  }

  SUBSTEP_INLINE void add(std::size_t p) {
    using V = typename Nodes::V;
    for (int part = 0; part < Nodes::kParts; ++part) {
      V upper[D], f[D], h[D];
      for (int d = 0; d < D; ++d) {
        upper[d] = Nodes::upper(part, d);
        f[d] = Nodes::weight(upper[d], weights_.f[usize(d)][p]);
        h[d] = Nodes::weight(upper[d], weights_.h[usize(d)][p]);
      }
      for (int c = 0; c < D; ++c) {
        V w = f[c];
        for (int d = 0; d < D; ++d) {
          if (d != c) w *= h[d];
        }
        V v = splat<V>(lowest_[usize(c)][p]);
        if constexpr (kAffine) {
          for (int d = 0; d < D; ++d) v = fma<V>(growth_[usize(c)][usize(d)][p], upper[d], v);
        }
        Real* const to = sums_[usize(c)].data() + at_[usize(c)][p] + part * Nodes::kLanes;
        const V momentum = fma<V>(w, v, load<V>(to));
        const V mass = w + load<V>(to + Nodes::kLanes * Nodes::kParts);
        std::memcpy(to, &momentum, sizeof momentum);
        std::memcpy(to + Nodes::kLanes * Nodes::kParts, &mass, sizeof mass);
      }
    }
  }

  const Particles<Real, D>& particles_;
  const Layout<D>& layout_;
  Real dx_;
  std::array<Sums, D> sums_;
  Weights weights_;
  std::array<Numbers, D> lowest_;
  std::array<std::array<Numbers, D>, D> growth_;
  std::array<typename Weights::template Numbers<IntOf<Real>>, D> at_;
};

template <class Real, int D, bool kAffine>
void transfer(const Particles<Real, D>& particles, const Layout<D>& layout, Real dx,
              const Faces<Real, D>& u, const Faces<Real, D>& weight, int threads) {
  add_by_slabs(
      layout, D,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::size_t c = 0; c < D; ++c) {
          std::fill(u[c] + begin, u[c] + end, Real(0));
          std::fill(weight[c] + begin, weight[c] + end, Real(0));
        }
      },
      [&](std::int64_t slab) {
        FaceSums<Real, D, kAffine>(particles, layout, dx).add_slab(slab, u, weight);
      },
      [&](int c) {
        fold_ghosts(layout, c, u[usize(c)]);
        fold_ghosts(layout, c, weight[usize(c)]);
      },
      [&](std::int64_t begin, std::int64_t end) {
        for (std::size_t c = 0; c < D; ++c) {
          Real* const __restrict velocity = u[c];
          const Real* const __restrict w = weight[c];
          for (std::int64_t i = begin; i < end; ++i) {
            velocity[i] = w[i] > 0 ? velocity[i] / w[i] : Real(0);
          }
        }
      },
      [&](int c) {
        fill_ghosts(layout, c, u[usize(c)]);
        fill_ghosts(layout, c, weight[usize(c)]);
      },
      threads);
}

}  // namespace

template <class Real, int D>
void transfer_to_grid(const Particles<Real, D>& particles, const Layout<D>& layout, Real dx,
                      const Faces<Real, D>& u, const Faces<Real, D>& weight, int threads) {
  if (particles.affine()) {
    transfer<Real, D, true>(particles, layout, dx, u, weight, threads);
  } else {
    transfer<Real, D, false>(particles, layout, dx, u, weight, threads);
  }
}

template void transfer_to_grid(const Particles<float, 2>&, const Layout<2>&, float,
                               const Faces<float, 2>&, const Faces<float, 2>&, int);
template void transfer_to_grid(const Particles<float, 3>&, const Layout<3>&, float,
                               const Faces<float, 3>&, const Faces<float, 3>&, int);
template void transfer_to_grid(const Particles<double, 2>&, const Layout<2>&, double,
                               const Faces<double, 2>&, const Faces<double, 2>&, int);
template void transfer_to_grid(const Particles<double, 3>&, const Layout<3>&, double,
                               const Faces<double, 3>&, const Faces<double, 3>&, int);

}  // namespace substep::gridfluid
