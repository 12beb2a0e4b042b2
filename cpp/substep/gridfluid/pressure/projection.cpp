#include "substep/gridfluid/pressure/projection.h"

#include <algorithm>
#include <cmath>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {

template <class Real, int D>
Projection<Real, D>::Projection(const Layout<D>& layout, const OpenSides<D>& open, bool varies)
    : layout_(layout), all_(layout), open_(open), varies_(varies) {
  assign(cells_, layout.size, Cell::kSolid);
  assign(b_, layout.size, Real(0));
  assign(q_, layout.size, 0.0);
  for (auto& weight : weight_) assign(weight, layout.size, Real(0));
}

template <class Real, int D>
void Projection<Real, D>::set_domain(const Obstacles<Real, D>& obstacles, std::span<const Real> phi,
                                     int threads) {
  find_cells(obstacles, phi, threads);
  if (varies_) return;
  find_weights(obstacles, phi, {}, threads);
  if (phi.empty() && !obstacles.any() && TransformSolver<Real, D>::can(layout_)) {
    solver_.reset();
    direct_.emplace(layout_, open_);
  } else {
    direct_.reset();
    set_matrix(threads);
  }
}

template <class Real, int D>
const FluidRows<D>& Projection<Real, D>::fluid() const {
  return direct_ ? all_ : solver_->fluid();
}

template <class Real, int D>
void Projection<Real, D>::set_density(const Obstacles<Real, D>& obstacles,
                                      std::span<const Real> density, int threads) {
  find_weights(obstacles, {}, density, threads);
}

template <class Real, int D>
void Projection<Real, D>::set_matrix(int threads) {
  if (!solver_) solver_.emplace(layout_);
  solver_->set_matrix(weights(), cells(), threads);
}

template <class Real, int D>
std::array<std::span<const Real>, D> Projection<Real, D>::weights() const {
  std::array<std::span<const Real>, D> w;
  for (int a = 0; a < D; ++a) w[usize(a)] = weight(a);
  return w;
}

// A cell is solid where an obstacle leaves none of its faces open.
template <class Real, int D>
void Projection<Real, D>::find_cells(const Obstacles<Real, D>& obstacles, std::span<const Real> phi,
                                     int threads) {
  for_rows(layout_, all_cells(layout_), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      bool open = !obstacles.any();
      for (int a = 0; a < D && !open; ++a) {
        const std::span<const Real> part = obstacles.open(a);
        open = part[usize(i)] > 0 || part[usize(i + layout_.stride[usize(a)])] > 0;
      }
      const bool liquid = phi.empty() || phi[usize(i)] < 0;
      cells_[usize(i)] = !open ? Cell::kSolid : liquid ? Cell::kFluid : Cell::kAir;
    }
  });
  // The ghosts beyond open sides are air; those of periodic axes are what is on the other side.
  wrap(layout_, std::span<Cell>(cells_.data(), cells_.size()), threads);
  for (int a = 0; a < D; ++a) {
    for (int side = 0; side < 2 && !layout_.periodic[usize(a)]; ++side) {
      if (!open_[usize(a)][usize(side)]) continue;
      for_side(layout_, a, side, [&](std::int64_t, std::int64_t ghost, std::int64_t) {
        cells_[usize(ghost)] = Cell::kAir;
      });
    }
  }
}

template <class Real, int D>
void Projection<Real, D>::find_weights(const Obstacles<Real, D>& obstacles,
                                       std::span<const Real> phi, std::span<const Real> density,
                                       int threads) {
  for (int a = 0; a < D; ++a) {
    const std::int64_t s = layout_.stride[usize(a)];
    const std::span<const Real> part =
        obstacles.any() ? obstacles.open(a) : std::span<const Real>();
    AlignedBuffer<Real>& weight = weight_[usize(a)];
    for_rows(layout_, all_faces(layout_, usize(a)), threads,
             [&](std::int64_t begin, std::int64_t end) {
               for (std::int64_t i = begin; i < end; ++i) {
                 const Cell below = cells_[usize(i - s)], above = cells_[usize(i)];
                 Real w = 0;
                 if (below == Cell::kFluid && above == Cell::kFluid) {
                   w = 1;
                 } else if (below != Cell::kSolid && above != Cell::kSolid && below != above) {
                   // One is fluid, the other air.
                   const std::int64_t in = below == Cell::kFluid ? i - s : i;
                   const std::int64_t out = below == Cell::kFluid ? i : i - s;
                   double theta = 0.5;
                   if (!phi.empty()) {
                     const double d = double(phi[usize(in)]);
                     theta = d / (d - double(phi[usize(out)]));
                   }
                   w = Real(1 / std::max(theta, kThinnest));
                 }
                 if (!density.empty()) w *= 2 / (density[usize(i - s)] + density[usize(i)]);
                 weight[usize(i)] = part.empty() ? w : w * part[usize(i)];
               }
             });
  }
}

// b = -sum_f s_f (A_f u_f + (1 - A_f) u_obstacle).
template <class Real, int D>
void Projection<Real, D>::find_divergence(const Obstacles<Real, D>& obstacles,
                                          const Velocity<Real, D>& u, int threads) {
  const bool cut = obstacles.any(), moving = obstacles.moving();
  for_fluid_cells(fluid(), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      Real sum = 0;
      for (std::size_t a = 0; a < D; ++a) {
        const int axis = static_cast<int>(a);
        const auto flux = [&](std::size_t f) {
          if (!cut) return u[a][f];
          const Real part = obstacles.open(axis)[f];
          const Real theirs = moving ? (1 - part) * obstacles.displacing(axis)[f] : Real(0);
          return part * u[a][f] + theirs;
        };
        sum += flux(usize(i + layout_.stride[a])) - flux(usize(i));
      }
      b_[usize(i)] = cells_[usize(i)] == Cell::kFluid ? -sum : Real(0);
    }
  });
}

template <class Real, int D>
void Projection<Real, D>::add_gradient(const Obstacles<Real, D>& obstacles, std::size_t axis,
                                       std::int64_t begin, std::int64_t end, Real factor,
                                       std::span<Real> x) const {
  const std::int64_t s = layout_.stride[axis];
  const Real* const w = weight_[axis].data();
  const double* const q = q_.data();
  const auto add = [&](const auto& over_theta) {
    for (std::int64_t i = begin; i < end; ++i) {
      x[usize(i)] += factor * Real((q[i] - q[i - s]) * double(over_theta(i)));
    }
  };
  if (direct() && axis < D - 1) return add([here = w[begin]](std::int64_t) { return here; });
  if (!obstacles.any()) return add([&](std::int64_t i) { return w[i]; });
  const Real* const part = obstacles.open(static_cast<int>(axis)).data();
  add([&](std::int64_t i) { return w[i] > 0 ? w[i] / part[i] : Real(0); });
}

// u' = u - s_f (q_f - q) / theta_f; a face that an obstacle closes moves with it. A row of each
// axis after the other, so that q comes from memory once.
template <class Real, int D>
void Projection<Real, D>::apply_pressure(const Obstacles<Real, D>& obstacles, bool moving,
                                         Velocity<Real, D> u, int threads) {
  for_fluid_faces(fluid(), threads, [&](std::size_t a, std::int64_t begin, std::int64_t end) {
    add_gradient(obstacles, a, begin, end, Real(-1), u[a]);
  });
  for (std::size_t a = 0; a < D && obstacles.any(); ++a) {
    const int axis = static_cast<int>(a);
    for_rows(layout_, all_faces(layout_, a), threads, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        if (weight_[a][usize(i)] > 0 || obstacles.open(axis)[usize(i)] != 0) continue;
        u[a][usize(i)] = moving ? obstacles.velocity(axis)[usize(i)] : Real(0);
      }
    });
  }
}

template <class Real, int D>
SolveReport Projection<Real, D>::solve(double tolerance, int max_iterations, int threads,
                                       const Bodies<Real, D>* bodies) {
  const std::span<const Real> b(b_.data(), b_.size());
  const SolveReport report =
      direct_ ? direct_->solve(weights(), b, q(), threads)
              : solver_->solve(b, q(), tolerance, max_iterations, threads, bodies);
  wrap(layout_, q(), threads);
  return report;
}

template <class Real, int D>
void Projection<Real, D>::let_yield(const Obstacles<Real, D>& obstacles, double mass, int threads) {
  bodies_.find(obstacles, solver_->inverse_diagonal(), mass, threads);
}

template <class Real, int D>
SolveReport Projection<Real, D>::project(Obstacles<Real, D>& obstacles, Velocity<Real, D> u,
                                         double tolerance, int max_iterations, int threads) {
  find_divergence(obstacles, u, threads);
  const SolveReport report = solve(tolerance, max_iterations, threads, &bodies_);
  if (report.converged && bodies_.any()) {
    bodies_.push(q(), obstacles.colliders, threads);
    bodies_.move(obstacles.colliders);
    obstacles.find(threads);
  }
  if (report.converged) apply_pressure(obstacles, obstacles.moving(), u, threads);
  return report;
}

template <class Real, int D>
SolveReport Projection<Real, D>::spread(const Obstacles<Real, D>& obstacles,
                                        std::span<const Real> source, Velocity<Real, D> d,
                                        double tolerance, int max_iterations, int threads) {
  for_numbers(layout_.size, threads, [&](std::size_t i) {
    b_[i] = source[i];
    q_[i] = 0;
    for (const std::span<Real>& component : d) component[i] = 0;
  });
  const SolveReport report = solve(tolerance, max_iterations, threads);
  apply_pressure(obstacles, false, d, threads);
  return report;
}

template class Projection<float, 2>;
template class Projection<float, 3>;
template class Projection<double, 2>;
template class Projection<double, 3>;

}  // namespace substep::gridfluid
