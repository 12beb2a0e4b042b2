// Where a liquid has no particles, and what comes out of there and goes into it.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/liquid/grid_liquid.h"

namespace substep::gridfluid {

// Deep will be what is far from air, obstacles, nozzles and sinks.
template <class Real, int D>
void GridLiquid<Real, D>::find_deep(double dt) {
  AlignedBuffer<std::uint8_t> liquid;
  assign(liquid, layout.size, std::uint8_t{0});
  const bool cut = obstacles.any();
  for_rows(layout, all_cells(layout), options.threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const bool open = !cut || (obstacles.room()[usize(i)] >= 1 && obstacles.at_centre(i) >= 0);
      liquid[usize(i)] = open && phi_[usize(i)] < 0;
      if (liquid[usize(i)] == 0 || flow.sinks.empty()) continue;
      const Vec3 x = middle(i);
      for (const auto& sink : flow.sinks) {
        if (sink->signed_distance(x).value < options.cell) liquid[usize(i)] = 0;
      }
    }
  });
  for (const geometry::Emitter& tap : flow.emitters) {
    for (const Vec3& offset : tap.offsets) {
      const Vec3 x = tap.position + offset;
      if (is_inside(x)) liquid[usize(cell_at(x))] = 0;
    }
  }
  reach_ = reach_of_deep(dt);
  band->find_deep(liquid, options.narrow_band + reach_ - 1, options.threads);
}

// Cells that what is in deep cells moves by at the most, rounded up.
template <class Real, int D>
int GridLiquid<Real, D>::reach_of_deep(double dt) const {
  const auto cells_of = static_cast<Real>(dt / options.cell);
  const Real most = gather_rows(
      layout, all_cells(layout), options.threads, Real(0),
      [&](std::int64_t begin, std::int64_t end) {
        Real part = 0;
        for (std::int64_t i = begin; i < end; ++i) {
          if (band->deep()[usize(i)] == 0) continue;
          for (std::size_t a = 0; a < D; ++a) {
            for (const std::int64_t f : {i, i + layout.stride[a]}) {
              const Real more = options.keep_volume ? std::abs(shift_[a][usize(f)]) : Real(0);
              part = std::max(part, std::abs(u_[a][usize(f)]) * cells_of + more);
            }
          }
        }
        return part;
      },
      [](Real& total, Real part) { total = std::max(total, part); });
  const int cells = *std::max_element(layout.cells.begin(), layout.cells.end());
  return most < static_cast<Real>(cells) ? 1 + static_cast<int>(most) : cells;
}

// Particles come out of cells that were deep, and those in cells that are it now go.
template <class Real, int D>
void GridLiquid<Real, D>::change_band(double dt) {
  const Transfer transfer = options.transfer == Transfer::kApic ? Transfer::kApic : Transfer::kPic;
  Particles<Real, D> collar = band->collar(reach_, next_.affine(), options.threads);
  if (move(collar, transfer, dt) >= 0) {
    throw NonFiniteError("a velocity in deep liquid is not finite; take a shorter step", time);
  }
  collar.erase(in_deep(collar), options.threads);
  std::iota(collar.id(), collar.id() + collar.size(), new_next_id_);
  new_next_id_ += collar.size();
  std::vector<std::uint8_t> gone = in_deep(next_);
  for (const std::int64_t row : band->excess()) gone[usize(row)] = 1;
  band->account(collar.size(), drop(gone));
  next_.append(collar);
  next_.shrink();
  band->advect(spans(u_), dt / options.cell, options.threads);
}

// Flags of particles in cells that will be deep.
template <class Real, int D>
std::vector<std::uint8_t> GridLiquid<Real, D>::in_deep(const Particles<Real, D>& of) const {
  std::vector<std::uint8_t> flags(usize(of.size()));
  parallel_for(
      of.size(), 4096,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t p = begin; p < end; ++p) {
          std::array<int, D> cell;
          for (std::size_t a = 0; a < D; ++a) {
            cell[a] = std::clamp(static_cast<int>(of.x(int(a))[p]), 0, layout.cells[a] - 1);
          }
          flags[usize(p)] = band->will_be_deep(layout.index(cell)) ? 1 : 0;
        }
      },
      options.threads);
  return flags;
}

// As of a body in the middle of each cell.
template <class Real, int D>
LiquidEnergies GridLiquid<Real, D>::energies_of_deep() const {
  const double m = cell_mass();
  const auto of_row = [&](std::int64_t begin, std::int64_t end) {
    LiquidEnergies part;
    for (std::int64_t i = begin; i < end; ++i) {
      if (band->deep()[usize(i)] == 0) continue;
      Vec3 v = Vec3::Zero();
      for (int a = 0; a < D; ++a) {
        const Field& u = band->velocity()[usize(a)];
        v[a] = (double(u[usize(i)]) + double(u[usize(i + layout.stride[usize(a)])])) / 2;
      }
      const Vec3 x = middle(i);
      part += {.kinetic = 0.5 * m * v.squaredNorm(),
               .potential = -m * options.gravity.dot(x),
               .momentum = m * v,
               .angular_momentum = m * x.cross(v)};
    }
    return part;
  };
  return gather_rows(layout, all_cells(layout), options.threads, LiquidEnergies{}, of_row,
                     [](LiquidEnergies& total, const LiquidEnergies& part) { total += part; });
}

template class GridLiquid<float, 2>;
template class GridLiquid<float, 3>;
template class GridLiquid<double, 2>;
template class GridLiquid<double, 3>;

}  // namespace substep::gridfluid
