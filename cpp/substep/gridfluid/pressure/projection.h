// Velocities without divergence: the pressure that makes them so, and what it does to them.
//
// For each fluid cell, with the open part A_f of each of its faces (Batty, Bertails and Bridson
// 2007; Ng, Min and Gibou 2009) and q = p dt / (density dx) [m/s],
//   sum_f A_f (q - q_f) / theta_f = -sum_f s_f (A_f u_f + (1 - A_f) u_obstacle),
//   u_f' = u_f - s_f (q_f - q) / theta_f,
// where s_f is 1 above the cell and -1 below it. theta_f is 1 between fluid cells; towards air it
// is the part of the way to the middle of the next cell that is liquid, and q_f = 0 there: the
// ghost fluid method, Enright, Nguyen, Gibou and Fedkiw, "Using the particle level set method and a
// second order accurate pressure boundary condition for free surface flows", 2003. At an open side
// of the box theta_f = 1/2. At its other sides A_f = 0, and u_f is what is prescribed there.
//
// Where the density varies from cell to cell (set_density), it is here that of q, and A_f is
// divided by the mean of it in the two cells beside the face: a flow passes the halves between
// their middles one after the other. At an open side it is that of the cell.
//
// Where fluid of one density fills the box and no obstacles are in it, and the numbers of cells
// allow, q is found by transforms, else by iteration.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/grid/cells.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/grid/sides.h"
#include "substep/gridfluid/pressure/bodies.h"
#include "substep/gridfluid/pressure/obstacles.h"
#include "substep/gridfluid/pressure/pressure_solver.h"
#include "substep/gridfluid/pressure/transform_solver.h"

namespace substep::gridfluid {

template <class Real, int D>
using Velocity = std::array<std::span<Real>, D>;  // of the faces [m/s]

template <class Real, int D>
class Projection {
 public:
  // varies: whether set_density() and set_matrix() say what the weights are.
  Projection(const Layout<D>& layout, const OpenSides<D>& open, bool varies = false);

  // phi: of the liquid at the middle of cells, below 0 inside, in cells, in ghosts too: beyond open
  // sides the negative of what is within. Empty where the fluid fills all that obstacles leave. To
  // be called before project(), when one of them has changed.
  void set_domain(const Obstacles<Real, D>& obstacles, std::span<const Real> phi, int threads);
  // density: of cells and ghosts, in parts of that of q. add_gradient() looks at it from here on,
  // project() from set_matrix().
  void set_density(const Obstacles<Real, D>& obstacles, std::span<const Real> density, int threads);
  void set_matrix(int threads);
  // Obstacles that yield do so in project(); mass: of a full cell of q's density [kg]. To be called
  // after set_domain() and set_matrix(), where any do.
  void let_yield(const Obstacles<Real, D>& obstacles, double mass, int threads);
  const Bodies<Real, D>& bodies() const { return bodies_; }
  // Where the report is that it has not converged, u and the obstacles are as they were.
  SolveReport project(Obstacles<Real, D>& obstacles, Velocity<Real, D> u, double tolerance,
                      int max_iterations, int threads);

  // Displacements of the faces, or velocities, whose divergence in fluid cells is `source`; what
  // the solver reached, converged or not. q() is lost.
  SolveReport spread(const Obstacles<Real, D>& obstacles, std::span<const Real> source,
                     Velocity<Real, D> d, double tolerance, int max_iterations, int threads);

  // Adds factor * (q_f - q) s_f / theta_f, as taken from velocities, to x of the faces of an axis.
  void add_gradient(const Obstacles<Real, D>& obstacles, std::size_t axis, std::int64_t begin,
                    std::int64_t end, Real factor, std::span<Real> x) const;
  // Whether q is found without a first guess.
  bool direct() const { return direct_.has_value(); }
  // Of the last call of project(), the first guess of the next.
  std::span<double> q() { return {q_.data(), q_.size()}; }
  std::span<const Cell> cells() const { return {cells_.data(), cells_.size()}; }
  // A_f / theta_f, over the density where that varies; above 0 where a fluid cell is on one side of
  // an open face.
  std::span<const Real> weight(int axis) const {
    return {weight_[usize(axis)].data(), weight_[usize(axis)].size()};
  }

 private:
  static constexpr double kThinnest = 0.01;  // theta; without a bound q would not be

  void find_cells(const Obstacles<Real, D>& obstacles, std::span<const Real> phi, int threads);
  void find_weights(const Obstacles<Real, D>& obstacles, std::span<const Real> phi,
                    std::span<const Real> density, int threads);
  std::array<std::span<const Real>, D> weights() const;
  void find_divergence(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u,
                       int threads);
  SolveReport solve(double tolerance, int max_iterations, int threads,
                    const Bodies<Real, D>* bodies = nullptr);
  void apply_pressure(const Obstacles<Real, D>& obstacles, bool moving, Velocity<Real, D> u,
                      int threads);

  const FluidRows<D>& fluid() const;

  Layout<D> layout_;
  FluidRows<D> all_;
  OpenSides<D> open_;
  bool varies_;
  AlignedBuffer<Cell> cells_;
  std::array<AlignedBuffer<Real>, D> weight_;
  AlignedBuffer<Real> b_;
  AlignedBuffer<double> q_;
  Bodies<Real, D> bodies_;
  // One of them, by the domain.
  std::optional<PressureSolver<Real, D>> solver_;
  std::optional<TransformSolver<Real, D>> direct_;
};

extern template class Projection<float, 2>;
extern template class Projection<float, 3>;
extern template class Projection<double, 2>;
extern template class Projection<double, 3>;

}  // namespace substep::gridfluid
