#include "substep/ode/systems/brusselator.h"

#include <algorithm>
#include <cmath>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/ode/explicit/rkc_stage.h"

namespace substep::ode {
namespace {

constexpr std::int64_t kCellsPerChunk = 4096;

}  // namespace

const SparsePattern* Brusselator::jacobian_pattern() const {
  std::call_once(once_, [&] {
    auto pattern = std::make_unique<SparsePattern>();
    const auto cells = static_cast<std::int32_t>(cells_);
    pattern->rows = pattern->cols = 2 * cells;
    std::int32_t around[8];
    for (int field = 0; field < 2; ++field) {
      for (std::int32_t cell = 0; cell < cells; ++cell) {
        const int count = stencil(cell, around);
        if (field == 1) pattern->row.push_back(cell);
        for (int k = 0; k < count; ++k) pattern->row.push_back(around[k] + field * cells);
        if (field == 0) pattern->row.push_back(cell + cells);
        pattern->start.push_back(static_cast<std::int32_t>(pattern->row.size()));
      }
    }
    pattern_ = std::move(pattern);
  });
  return pattern_.get();
}

void Brusselator::jacobian(double, const double* y, double* values) {
  const SparsePattern& pattern = *jacobian_pattern();
  const double *u = y, *v = y + cells_;
  const double from_centre = -neighbours_ * c_;
  parallel_for(2 * cells_, kCellsPerChunk, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t j = begin; j < end; ++j) {
      const bool of_u = j < cells_;
      const std::int64_t cell = of_u ? j : j - cells_;
      const double own = of_u ? reaction_.uu(u[cell], v[cell]) : reaction_.vv(u[cell]);
      const double other = of_u ? reaction_.vu(u[cell], v[cell]) : reaction_.uv(u[cell]);
      const std::int64_t other_row = of_u ? cell + cells_ : cell;
      for (std::int32_t k = pattern.start[j]; k < pattern.start[j + 1]; ++k) {
        const std::int32_t row = pattern.row[k];
        values[k] = row == j ? own + from_centre : row == other_row ? other : c_;
      }
    }
  });
}

// Gershgorin's circles by rows.
double Brusselator::spectral_radius(double, const double* y) {
  const double *u = y, *v = y + cells_;
  std::vector<double> greatest(usize((cells_ - 1) / kCellsPerChunk + 1));
  parallel_for(cells_, kCellsPerChunk, [&](std::int64_t begin, std::int64_t end) {
    double most = 0.0;
    for (std::int64_t i = begin; i < end; ++i) {
      const double of_u = std::fabs(reaction_.uu(u[i], v[i])) + reaction_.uv(u[i]);
      const double of_v = std::fabs(reaction_.vu(u[i], v[i])) + reaction_.uv(u[i]);
      const double row = of_u > of_v ? of_u : of_v;
      most = row > most ? row : most;
    }
    greatest[usize(begin / kCellsPerChunk)] = most;
  });
  return 2.0 * neighbours_ * c_ + *std::max_element(greatest.begin(), greatest.end());
}

// On a line: u = a, v = b / a at both ends.

Brusselator1D::Brusselator1D(std::int64_t n, double alpha, double a, double b)
    : Brusselator(n, 2, alpha * static_cast<double>(n + 1) * static_cast<double>(n + 1), {a, b}) {}

int Brusselator1D::stencil(std::int64_t cell, std::int32_t* cells) const {
  int count = 0;
  for (std::int64_t k = std::max<std::int64_t>(cell - 1, 0); k <= cell + 1 && k < cells_; ++k) {
    cells[count++] = static_cast<std::int32_t>(k);
  }
  return count;
}

// use(i, second differences of u and of v there), with the values beyond the ends given.
template <class Use>
void Brusselator1D::for_cells(const double* y, double u_end, double v_end, int threads,
                              Use&& use) const {
  const std::int64_t n = cells_;
  const double *u = y, *v = y + n;
  const double c = c_;
  parallel_for(
      n, kCellsPerChunk,
      [&](std::int64_t begin, std::int64_t end) {
        const auto one = [&](std::int64_t i) {
          const double u_left = i > 0 ? u[i - 1] : u_end, u_right = i < n - 1 ? u[i + 1] : u_end;
          const double v_left = i > 0 ? v[i - 1] : v_end, v_right = i < n - 1 ? v[i + 1] : v_end;
          use(i, c * (u_left - 2.0 * u[i] + u_right), c * (v_left - 2.0 * v[i] + v_right));
        };
        if (begin == 0) one(0);
        const std::int64_t last = std::min(end, n - 1);
#pragma GCC ivdep
        for (std::int64_t i = std::max<std::int64_t>(begin, 1); i < last; ++i) {
          use(i, c * (u[i - 1] - 2.0 * u[i] + u[i + 1]), c * (v[i - 1] - 2.0 * v[i] + v[i + 1]));
        }
        if (end == n && n > 1) one(n - 1);
      },
      threads);
}

void Brusselator1D::rhs(double, const double* y, double* dydt) {
  const double *u = y, *v = y + cells_;
  double *du = dydt, *dv = dydt + cells_;
  const BrusselatorReaction r = reaction_;
  for_cells(y, r.a, r.b / r.a, 0, [=](std::int64_t i, double diffusion_u, double diffusion_v) {
    du[i] = r.u(u[i], v[i]) + diffusion_u;
    dv[i] = r.v(u[i], v[i]) + diffusion_v;
  });
}

bool Brusselator1D::rkc_stage(const RkcStage& s) {
  const double *u = s.y1, *v = s.y1 + cells_;
  const std::int64_t n = cells_;
  const BrusselatorReaction r = reaction_;
  for_cells(s.y1, r.a, r.b / r.a, s.threads,
            [=](std::int64_t i, double diffusion_u, double diffusion_v) {
              const double f_u = r.u(u[i], v[i]) + diffusion_u;
              const double f_v = r.v(u[i], v[i]) + diffusion_v;
              s.y2[i] = s.sum(i, f_u);
              s.y2[n + i] = s.sum(n + i, f_v);
            });
  return true;
}

void Brusselator1D::jacobian_product(double, const double* y, const double* v, double* out) {
  const std::int64_t n = cells_;
  const BrusselatorReaction r = reaction_;
  for_cells(v, 0.0, 0.0, 0, [=](std::int64_t i, double diffusion_u, double diffusion_v) {
    const double U = y[i], V = y[n + i];
    out[i] = r.uu(U, V) * v[i] + r.uv(U) * v[n + i] + diffusion_u;
    out[n + i] = r.vu(U, V) * v[i] + r.vv(U) * v[n + i] + diffusion_v;
  });
}

// On the periodic unit square.

Brusselator2D::Brusselator2D(std::int64_t n, double alpha, double a, double b, double source,
                             double source_time)
    : Brusselator(n * n, 4, alpha * static_cast<double>(n * n), {a, b}),
      n_(n),
      source_(source),
      source_time_(source_time) {
  // (x - 0.3)^2 + (y - 0.6)^2 <= 0.1^2, with the rounding of nodes on the edge allowed for.
  const double width = 1.0 / static_cast<double>(n);
  for (std::int64_t j = 0; j < n; ++j) {
    Range range{n, 0};
    for (std::int64_t i = 0; i < n; ++i) {
      const double x = static_cast<double>(i) * width - 0.3;
      const double z = static_cast<double>(j) * width - 0.6;
      if (x * x + z * z > 0.01 + 1e-12) continue;
      range = {std::min(range.begin, i), i + 1};
    }
    if (range.begin >= range.end) range = {0, 0};
    disc_.push_back(range);
  }
}

int Brusselator2D::stencil(std::int64_t cell, std::int32_t* cells) const {
  const std::int64_t i = cell % n_, j = cell / n_;
  const auto at = [&](std::int64_t column, std::int64_t row) {
    return static_cast<std::int32_t>((row + n_) % n_ * n_ + (column + n_) % n_);
  };
  const std::int32_t around[] = {at(i, j), at(i - 1, j), at(i + 1, j), at(i, j - 1), at(i, j + 1)};
  std::copy(std::begin(around), std::end(around), cells);
  std::sort(cells, cells + 5);
  return 5;
}

// use(row, segment) for each row; segment(begin, end, one) calls one(k, diffusion of u and of v)
// for its cells from begin to end, k the cell.
template <class Use>
void Brusselator2D::for_rows(const double* y, int threads, Use&& use) const {
  const std::int64_t n = n_, rows_of_chunk = std::max<std::int64_t>(1, kCellsPerChunk / n);
  const double c = c_;
  parallel_for(
      n, rows_of_chunk,
      [&](std::int64_t first, std::int64_t last) {
        for (std::int64_t j = first; j < last; ++j) {
          const double *u = y + j * n, *v = u + n * n;
          const std::int64_t below = ((j + n - 1) % n - j) * n, above = ((j + 1) % n - j) * n;
          use(j, [=](std::int64_t begin, std::int64_t end, auto&& one) {
            const auto cell = [&](std::int64_t i, std::int64_t left,
                                  std::int64_t right) __attribute__((always_inline)) {
              const double around_u = (u[left] + u[right]) + (u[i + below] + u[i + above]);
              const double around_v = (v[left] + v[right]) + (v[i + below] + v[i + above]);
              one(j * n + i, c * (around_u - 4.0 * u[i]), c * (around_v - 4.0 * v[i]));
            };
            if (begin == 0 && end > 0) cell(0, n - 1, 1);
            const std::int64_t stop = std::min(end, n - 1);
#pragma GCC ivdep
            for (std::int64_t i = std::max<std::int64_t>(begin, 1); i < stop; ++i) {
              cell(i, i - 1, i + 1);
            }
            if (end == n && begin < n) cell(n - 1, n - 2, 0);
          });
        }
      },
      threads);
}

// store(k, f_u, f_v) for each cell.
template <class Store>
void Brusselator2D::evaluate(double t, const double* y, int threads, Store&& store) const {
  const bool on = t >= source_time_;
  const double *u = y, *v = y + cells_;
  for_rows(y, threads, [&](std::int64_t j, auto&& segment) {
    const Range disc = on ? disc_[usize(j)] : Range{0, 0};
    const auto with = [&](double source) {
      return [=, r = reaction_](std::int64_t k, double diffusion_u,
                                double diffusion_v) __attribute__((always_inline)) {
        store(k, (r.u(u[k], v[k]) + source) + diffusion_u, r.v(u[k], v[k]) + diffusion_v);
      };
    };
    segment(0, disc.begin, with(0.0));
    segment(disc.begin, disc.end, with(source_));
    segment(disc.end, n_, with(0.0));
  });
}

void Brusselator2D::rhs(double t, const double* y, double* dydt) {
  double *du = dydt, *dv = dydt + cells_;
  evaluate(t, y, 0, [=](std::int64_t k, double f_u, double f_v) {
    du[k] = f_u;
    dv[k] = f_v;
  });
}

bool Brusselator2D::rkc_stage(const RkcStage& s) {
  const std::int64_t n = cells_;
  evaluate(s.t, s.y1, s.threads,
           [=](std::int64_t k, double f_u, double f_v) __attribute__((always_inline)) {
             s.y2[k] = s.sum(k, f_u);
             s.y2[n + k] = s.sum(n + k, f_v);
           });
  return true;
}

void Brusselator2D::jacobian_product(double, const double* y, const double* v, double* out) {
  const std::int64_t cells = cells_;
  for_rows(v, 0, [&](std::int64_t, auto&& segment) {
    segment(0, n_, [=, r = reaction_](std::int64_t k, double diffusion_u, double diffusion_v) {
      const double U = y[k], V = y[cells + k];
      out[k] = r.uu(U, V) * v[k] + r.uv(U) * v[cells + k] + diffusion_u;
      out[cells + k] = r.vu(U, V) * v[k] + r.vv(U) * v[cells + k] + diffusion_v;
    });
  });
}

}  // namespace substep::ode
