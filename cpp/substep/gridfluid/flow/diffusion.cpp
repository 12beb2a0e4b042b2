#include "substep/gridfluid/flow/diffusion.h"

#include <algorithm>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::gridfluid {
namespace {

constexpr double kNearest = 0.05;  // theta, so that a step can be solved for
constexpr double kOn = 1e-3;  // cells from the surface, where rounding must not decide on a side

// What rows append to lists, in their order.
template <class Lists, int D, class OfCell>
Lists collect(const Layout<D>& layout, const Block<D>& block, int threads, const OfCell& of_cell) {
  const std::int64_t rows = block.rows();
  std::vector<Lists> parts(usize((rows + kRowsOfTask - 1) / kRowsOfTask));
  parallel_for(
      rows, kRowsOfTask,
      [&](std::int64_t first, std::int64_t last) {
        for (std::int64_t r = first; r < last; ++r) {
          std::array<int, D> cell = block.row(r);
          const std::int64_t begin = layout.index(cell);
          for (std::int64_t i = begin; i < begin + block.length(); ++i, ++cell[D - 1]) {
            of_cell(cell, i, parts[usize(first / kRowsOfTask)]);
          }
        }
      },
      threads);
  Lists all;
  for (const Lists& part : parts) {
    all.fixed.insert(all.fixed.end(), part.fixed.begin(), part.fixed.end());
    all.cut.insert(all.cut.end(), part.cut.begin(), part.cut.end());
  }
  return all;
}

template <class Cut>
struct Lists {
  std::vector<std::int64_t> fixed;
  std::vector<Cut> cut;
};

}  // namespace

template <class Real, int D>
void Diffusion<Real, D>::find_faces(const SideGhosts<Real, D>& sides,
                                    const Obstacles<Real, D>& obstacles, std::size_t axis,
                                    bool slip, int threads) {
  block_ = sides.free_faces(axis);
  plain_ = sides.inner_faces(axis);
  const bool any = obstacles.any(), moving = obstacles.moving();
  const int a = static_cast<int>(axis);
  const std::span<const Real> open = any ? obstacles.open(a) : std::span<const Real>();
  const auto far = [&](std::int64_t i) { return obstacles.at_face(i, axis); };
  const auto in_obstacle = [&](std::int64_t i) {
    return slip ? open[usize(i)] == 0 : far(i) <= Real(kOn) || open[usize(i)] == 0;
  };
  const auto theirs = [&](std::int64_t i) {
    return moving ? obstacles.velocity(a)[usize(i)] : Real(0);
  };
  auto found = collect<Lists<Cut>>(
      layout_, block_, threads, [&](const std::array<int, D>& cell, std::int64_t i, auto& lists) {
        const bool in_side =
            !layout_.periodic[axis] && (cell[axis] == 0 || cell[axis] == layout_.cells[axis]);
        if (any && in_obstacle(i)) {
          lists.fixed.push_back(i);
          return;
        }
        if (!in_side && (!any || far(i) > 2)) return;
        Cut cut{.index = i, .weight = {}, .to_surface = 0, .surface = 0};
        bool differs = in_side;
        for (std::size_t b = 0; b < D; ++b) {
          for (std::size_t end = 0; end < 2; ++end) {
            const std::int64_t j = i + (end == 0 ? -1 : 1) * layout_.stride[b];
            const int at = cell[b] + (end == 0 ? -1 : 1);
            const int last = layout_.cells[b] - (b == axis && !layout_.periodic[b] ? 0 : 1);
            const bool beyond = at < 0 || at > last;
            Real& weight = cut.weight[2 * b + end];
            weight = beyond && b == axis && !layout_.periodic[b] ? Real(0) : Real(1);
            if (beyond || !any || !in_obstacle(j)) continue;
            differs = true;
            weight = 0;
            if (slip) continue;
            const Real here = far(i), there = std::min(far(j), Real(0));
            const Real theta = std::max(here / (here - there), Real(kNearest));
            cut.to_surface += 1 / theta;
            cut.surface += ((1 - theta) * theirs(i) + theta * theirs(j)) / theta;
          }
        }
        if (differs) lists.cut.push_back(cut);
      });
  fixed_ = std::move(found.fixed);
  cut_ = std::move(found.cut);
}

template <class Real, int D>
void Diffusion<Real, D>::find_cells(const Obstacles<Real, D>& obstacles,
                                    std::span<const Cell> cells, int threads) {
  block_ = plain_ = all_cells(layout_);
  fixed_.clear();
  cut_.clear();
  if (!obstacles.any()) return;
  auto found = collect<Lists<Cut>>(
      layout_, block_, threads, [&](const std::array<int, D>&, std::int64_t i, auto& lists) {
        if (cells[usize(i)] == Cell::kSolid) {
          lists.fixed.push_back(i);
          return;
        }
        Cut cut{.index = i, .weight = {}, .to_surface = 0, .surface = 0};
        bool differs = false;
        for (std::size_t b = 0; b < D; ++b) {
          for (std::size_t end = 0; end < 2; ++end) {
            const std::int64_t face = end == 0 ? i : i + layout_.stride[b];
            const Real part = obstacles.open(static_cast<int>(b))[usize(face)];
            cut.weight[2 * b + end] = part;
            differs |= part < 1;
          }
        }
        if (differs) lists.cut.push_back(cut);
      });
  fixed_ = std::move(found.fixed);
  cut_ = std::move(found.cut);
}

// out = own x + factor L x, with what is given at surfaces or with 0 there.
template <class Real, int D>
void Diffusion<Real, D>::spread(Real own, Real factor, bool surfaces, std::span<const Real> x,
                                std::span<Real> out, int threads) const {
  const auto s = layout_.stride;
  for_rows(layout_, plain_, threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {  // of differences: own may be lost beside factor
      const Real here = x[usize(i)];
      Real sum = (x[usize(i - s[0])] - here) + (x[usize(i + s[0])] - here) +
                 ((x[usize(i - s[1])] - here) + (x[usize(i + s[1])] - here));
      if constexpr (D == 3) sum += (x[usize(i - s[2])] - here) + (x[usize(i + s[2])] - here);
      out[usize(i)] = own * here + factor * sum;
    }
  });
  for (const Cut& cut : cut_) {
    const std::int64_t i = cut.index;
    const Real here = x[usize(i)];
    Real sum = (surfaces ? cut.surface : Real(0)) - cut.to_surface * here;
    for (std::size_t b = 0; b < D; ++b) {
      for (std::size_t end = 0; end < 2; ++end) {
        const Real w = cut.weight[2 * b + end];
        if (w == 0) continue;
        sum += w * (x[usize(i + (end == 0 ? -s[b] : s[b]))] - here);
      }
    }
    out[usize(i)] = own * here + factor * sum;
  }
  for (const std::int64_t i : fixed_) out[usize(i)] = 0;
}

template <class Real, int D>
void Diffusion<Real, D>::apply(std::span<const Real> x, std::span<Real> out, int threads) const {
  spread(Real(0), Real(1), true, x, out, threads);
}

template class Diffusion<float, 2>;
template class Diffusion<float, 3>;
template class Diffusion<double, 2>;
template class Diffusion<double, 3>;

}  // namespace substep::gridfluid
