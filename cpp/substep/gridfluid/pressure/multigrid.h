// Multigrid preconditioner of the pressure equation.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/grid/cells.h"
#include "substep/gridfluid/grid/rows.h"

namespace substep::gridfluid {

template <class Real, int D>
class Multigrid {
 public:
  using Coefficients = std::array<std::span<const Real>, D>;

  explicit Multigrid(const Layout<D>& layout);
  void set_matrix(const Coefficients& w, std::span<const Cell> cells, int threads);
  // z from r. In all three what is not fluid holds zeros, before and after.
  void precondition(std::span<const Real> r, std::span<Real> z, std::span<Real> scratch,
                    int threads);
  const AlignedBuffer<Real>& inverse_diagonal() const { return levels_[0].inverse_diagonal; }
  const FluidRows<D>& fluid() const { return levels_[0].fluid; }
  std::size_t bytes() const;

 private:
  static constexpr std::int64_t kSerial = 1 << 13;  // cells of a level that is not worth sharing

  struct Level {
    explicit Level(const Layout<D>& layout_) : layout(layout_), fluid(layout) {}
    Layout<D> layout;
    FluidRows<D> fluid;
    bool odd = false;  // a periodic axis, which two colours do not fit
    std::array<const Real*, D> w{};
    AlignedBuffer<Real> inverse_diagonal;  // 0 where there is no unknown
    const Real* b = nullptr;
    Real *x = nullptr, *r = nullptr;
    // Of the coarser levels.
    std::array<AlignedBuffer<Real>, D> own_w;
    AlignedBuffer<Real> own_b, own_x, own_r;
    std::array<std::array<AlignedBuffer<Real>, 2>, D> lean, loss, own_air;
  };
  void smooth_before(Level& level, int threads);
  void smooth_after(Level& level, const Level& coarse, int threads);
  void cycle(std::size_t l, int threads);
  static void add_columns(const Level& fine, Level& coarse, std::size_t a, int side,
                          const std::array<std::int64_t, 5>& column, std::int64_t at, int n);
  static void coarsen_row(const Level& fine, Level& coarse, int k, int j, const Row<D>& row);
  static void find_fluid(const Level& fine, Level& coarse, int threads);
  void coarsen(const Level& fine, Level& coarse, int threads);

  std::vector<Level> levels_;
};

extern template class Multigrid<float, 2>;
extern template class Multigrid<float, 3>;
extern template class Multigrid<double, 2>;
extern template class Multigrid<double, 3>;

}  // namespace substep::gridfluid
