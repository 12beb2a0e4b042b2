#include "substep/gridfluid/liquid/grid_liquid.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/rows_by_id.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/grid/sides.h"
#include "substep/gridfluid/grid/text.h"
#include "substep/gridfluid/particles/density.h"
#include "substep/gridfluid/particles/surface.h"
#include "substep/gridfluid/particles/transfer_to_grid.h"
#include "substep/gridfluid/pressure/surface_push.h"

namespace substep::gridfluid {
namespace {

constexpr int kLayers = 3;           // of faces beyond the liquid that get velocities
constexpr double kLeastRoom = 0.25;  // that counts of particles are divided by

}  // namespace

template <class Real, int D>
void GridLiquid<Real, D>::step(double dt) {
  flow.check(time + dt);
  const std::vector<geometry::Collider> colliders = obstacles.colliders;
  new_report_ = {};
  new_next_id_ = next_id;
  try {
    sort(dt);
    accelerate_bodies(dt);
    find_surface();
    if (band) band->find_edge(next_, density_.data(), phi_.data(), options.threads);
    projection_.set_domain(obstacles, {phi_.data(), phi_.size()}, options.threads);
    if (obstacles.any()) projection_.let_yield(obstacles, cell_mass(), options.threads);
    push_bodies_before(dt);
    pass_to_grid();
    accelerate(dt);
    if (options.surface_tension > 0) pull_surface(dt);
    project(dt);
    if (options.keep_volume) find_displacement();
    if (band) find_deep(dt);
    move_obstacles(dt);
    move_particles(dt);
    if (band) change_band(dt);
    let_flow(time + dt);
  } catch (...) {
    obstacles.colliders = colliders;
    throw;
  }
  commit(dt);
}

// The particles in the order of their cells, with what external forces give them.
template <class Real, int D>
void GridLiquid<Real, D>::sort(double dt) {
  next_.take_sorted(particles, layout, options.threads);
  if (forces.empty()) return;
  const auto rows_of = [&](const Particles<Real, D>& of) {
    return rows_by_id({of.id(), usize(of.size())}, next_id);
  };
  const std::vector<std::size_t> from = rows_of(particles), to = rows_of(next_);
  const double rate = dt / mass();
  for (std::size_t k = 0; k < from.size(); ++k) {
    for (int a = 0; a < D; ++a) {
      next_.v(a)[to[k]] += static_cast<Real>(rate * double(forces[from[k]][usize(a)]));
    }
  }
}

// Bodies that yield, by what is known of them.
template <class Real, int D>
void GridLiquid<Real, D>::accelerate_bodies(double dt) {
  geometry::accelerate_bodies(obstacles.colliders, dt);
  free_motion_.clear();
  given_.clear();
  const auto yields = [](const geometry::Collider& collider) { return collider.yields(); };
  if (!std::any_of(obstacles.colliders.begin(), obstacles.colliders.end(), yields)) return;
  for (const geometry::Collider& collider : obstacles.colliders)
    free_motion_.push_back(collider.body_velocity());
  given_.resize(free_motion_.size());
}

template <class Real, int D>
void GridLiquid<Real, D>::find_surface() {
  poll_interrupt();
  obstacles.find(options.threads);
  number_density(next_, layout, static_cast<Real>(1 << D), density_.data(), options.threads);
  if (band) band->add_density(density_.data(), options.threads);
  count_obstacles_in();
  gridfluid::level_set(next_, layout, density_.data(), SurfaceOptions<Real>{}, phi_.data(),
                       scratch_, options.threads);
  extend_surface();
}

// Densities of what obstacles leave of the cells around.
template <class Real, int D>
void GridLiquid<Real, D>::count_obstacles_in() {
  if (!obstacles.any()) return;
  const std::span<const Real> room = obstacles.room();
  for_rows(layout, all_cells(layout), options.threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i)
      density_[usize(i)] /= std::max(room[usize(i)], Real(kLeastRoom));
  });
  fill_ghosts(layout, kCentres, density_.data(), options.threads);
}

// The liquid goes on into obstacles that it touches: else a cell of which they cover the middle
// would count as air, and the liquid beside it would shoot there. One of which they cover nearly
// that much may have no particle by chance: it is as deep in it as what is before it. (The former
// are half a cell deep: with what is before them, fronts would meet walls in spikes of pressure; an
// empty one that liquid is all around has a phi of up to kAmong.) Not where obstacles lean over
// such a cell and it touches air by more than a slit, as in the wedge that the surface and a wall
// above it leave: what is empty there would count as liquid, and nothing could flow in. (Slits: a
// light ball that lies on water would leap. On what leans away, the tip of the water would not be
// held.)
template <class Real, int D>
void GridLiquid<Real, D>::extend_surface() {
  constexpr Real kNear = 0.5, kAmong = 0.62, kInside = -0.5, kBeside = 0.35, kBefore = 0.5,
                 kFar = 2;       // [cells]
  constexpr Real kSlit = 0.3;    // of a face
  constexpr double kLean = 0.1;  // sine of an angle
  const double g = std::sqrt(std::inner_product(options.gravity.begin(), options.gravity.end(),
                                                options.gravity.begin(), 0.0));
  using Place = std::array<int, D>;
  const auto extend = [&](const Place& cell, std::int64_t i, bool within) {
    Real& phi = phi_[usize(i)];
    if (phi < kInside || obstacles.distance()[usize(i)] > kFar) return;
    const Real here = obstacles.at_centre(i);
    if (within ? here >= 0 : here < 0 || here >= kBeside || phi < 0 || phi >= kNear) return;
    Real furthest = within ? Real(0) : here + kBefore;  // of those it touches
    Real extended = within && phi < kAmong ? kInside : phi;
    bool at_air = false;
    double lean = 0;  // twice g times how fast the obstacles' distance grows downwards
    for (std::size_t a = 0; a < D; ++a) {
      for (const int way : {-1, 1}) {
        const int n = layout.cells[a], to = cell[a] + way;
        if ((to < 0 || to >= n) && !layout.periodic[a]) continue;
        const std::int64_t other = i + ((to + n) % n - cell[a]) * layout.stride[a];
        const std::int64_t face = way > 0 ? i + layout.stride[a] : i;
        const Real open = obstacles.open(static_cast<int>(a))[usize(face)];
        const Real there = obstacles.at_centre(other), phi_there = phi_[usize(other)];
        lean += way * static_cast<double>(there) * options.gravity[a];
        if (!(open > 0)) continue;
        if (phi_there < 0 && there >= furthest) {
          furthest = there;
          extended = within ? kInside : phi_there;
        } else if (!(phi_there < 0) && open > kSlit && there > (within ? Real(0) : kBeside)) {
          at_air = true;
        }
      }
    }
    if (!(at_air && lean > 2 * kLean * g)) phi = extended;
  };
  for (const bool within : {false, true}) {  // each looks at what it does not change
    if (!obstacles.any()) break;
    for_placed_rows(layout, all_cells(layout), options.threads,
                    [&](Place cell, std::int64_t begin, std::int64_t end) {
                      for (std::int64_t i = begin; i < end; ++i, ++cell[D - 1])
                        extend(cell, i, within);
                    });
  }
  for (int a = 0; a < D; ++a) {  // beyond open sides is air: see Projection
    for (int side = 0; side < 2; ++side) {
      if (!options.open[usize(a)][usize(side)]) continue;
      for_side(layout, a, side, [&](std::int64_t in, std::int64_t out, std::int64_t) {
        phi_[usize(out)] = -phi_[usize(in)];
      });
    }
  }
}

// Bodies that respond, by what is known of the pressure at their surface: see surface_push.h.
template <class Real, int D>
void GridLiquid<Real, D>::push_bodies_before(double dt) {
  if (!projection_.bodies().any()) return;
  const bool first = last_dt == 0;
  const std::span<const double> known =
      first ? find_first_pressure(dt) : std::span<const double>(q.data(), q.size());
  const double scale = first ? 1 : dt / last_dt;  // q grows with the step
  push_before(obstacles, projection_.cells(), known, scale * cell_mass(), options.threads);
  for (std::size_t c = 0; c < given_.size(); ++c) given_[c] = obstacles.colliders[c].exchange();
  projection_.bodies().move(obstacles.colliders);
  obstacles.find(options.threads);
}

// Where none is known yet: that of this step, if bodies had no such push.
template <class Real, int D>
std::span<const double> GridLiquid<Real, D>::find_first_pressure(double dt) {
  pass_to_grid();
  accelerate(dt);
  if (options.surface_tension > 0) pull_surface(dt);
  make_incompressible(0);
  new_report_ = {};
  reset_bodies();
  return projection_.q();
}

template <class Real, int D>
void GridLiquid<Real, D>::pass_to_grid() {
  transfer_to_grid(next_, layout, static_cast<Real>(options.cell), faces(u_), faces(weight_),
                   options.threads);
  if (band) {
    band->add_velocity(static_cast<Real>(1 << D), faces(u_), faces(weight_), options.threads);
  }
  fill_around(u_, 2);
  for (std::size_t a = 0; a < D; ++a) {
    if (options.transfer == Transfer::kFlip || options.viscosity > 0)
      copy(u_[a], old_u_[a], options.threads);
    if (options.viscosity == 0) continue;
    met_[a].reset(weight_[a].size());
    copy(weight_[a], met_[a], options.threads);
  }
}

template <class Real, int D>
void GridLiquid<Real, D>::accelerate(double dt) {
  for (int a = 0; a < D; ++a) {
    const Real du = static_cast<Real>(dt * options.gravity[a]);
    if (du == 0) continue;
    for_numbers(layout.size, options.threads, [&](std::size_t i) { u_[usize(a)][i] += du; });
  }
  for_walls([&](std::size_t a, std::int64_t face) { u_[a][usize(face)] = 0; });
}

template <class Real, int D>
void GridLiquid<Real, D>::pull_surface(double dt) {
  const double q_of_curvature =
      options.surface_tension * dt / (options.density * options.cell * options.cell);
  surface_tension_.pull(layout, obstacles, projection_, phi_.data(), q_of_curvature, spans(u_),
                        options.threads);
}

// each(axis, face) for those of the sides that are walls.
template <class Real, int D>
template <class Each>
void GridLiquid<Real, D>::for_walls(const Each& each) const {
  for (int a = 0; a < D; ++a) {
    for (int side = 0; side < 2 && !layout.periodic[usize(a)]; ++side) {
      if (options.open[usize(a)][usize(side)]) continue;
      for_side(layout, a, side,
               [&](std::int64_t, std::int64_t, std::int64_t face) { each(usize(a), face); });
    }
  }
}

// With viscosity a first pressure takes what compresses from the velocities: no strain should come
// of what no strain is to be, as of the weight of a pool at rest. What is left at the surface and
// at walls a second one takes.
template <class Real, int D>
void GridLiquid<Real, D>::project(double dt) {
  make_incompressible(last_dt > 0 ? dt / last_dt : 0);
  new_q_.reset(q.size());
  copy(projection_.q(), new_q_, options.threads);
  if (options.viscosity > 0) {
    change_around();
    make_viscous(dt);
    viscosity_.add_pressure(obstacles, spans(u_), projection_.cells(),
                            {new_q_.data(), new_q_.size()}, options.threads);
    make_incompressible(0);
    const std::span<const double> more = projection_.q();
    for_numbers(layout.size, options.threads, [&](std::size_t i) { new_q_[i] += more[i]; });
    viscosity_.mark(faces(weight_));
  }
  fill_around(u_, kLayers);
  if (obstacles.any()) push_obstacles(dt);
}

// By a pressure, with that of the last step times a number as first guess.
template <class Real, int D>
void GridLiquid<Real, D>::make_incompressible(double guess) {
  poll_interrupt();
  const std::span<double> next_q = projection_.q();
  for_numbers(layout.size, options.threads, [&](std::size_t i) { next_q[i] = guess * q[i]; });
  const SolveReport solved = projection_.project(obstacles, spans(u_), options.tolerance,
                                                 options.max_iterations, options.threads);
  new_report_.iterations += solved.iterations;
  new_report_.residual = solved.residual;
  new_report_.converged = solved.converged;
  if (!std::isfinite(solved.residual)) {
    throw NonFiniteError("the velocities are too large for a pressure; take a shorter step", time);
  }
  if (!solved.converged) {
    throw ConvergenceError("the pressure has a relative residual of " + text(solved.residual) +
                               " after " + std::to_string(solved.iterations) +
                               " iterations; allow more (max_iterations=) or a larger one "
                               "(tolerance=)",
                           time);
  }
  for (std::size_t c = 0; c < given_.size(); ++c) given_[c] += obstacles.colliders[c].exchange();
  find_valid();
}

// Faces beside those of the pressure are changed by as much as those around.
template <class Real, int D>
void GridLiquid<Real, D>::change_around() {
  for (std::size_t a = 0; a < D; ++a) {
    for_numbers(layout.size, options.threads,
                [&](std::size_t i) { shift_[a][i] = u_[a][i] - old_u_[a][i]; });
  }
  fill_around(shift_, kLayers);
  for (std::size_t a = 0; a < D; ++a) {
    for_numbers(layout.size, options.threads, [&](std::size_t i) {
      if (!(weight_[a][i] > 0)) u_[a][i] = old_u_[a][i] + shift_[a][i];
    });
  }
}

template <class Real, int D>
void GridLiquid<Real, D>::make_viscous(double dt) {
  const double k = options.viscosity * dt / (options.cell * options.cell);
  hold_nozzles();
  const ViscosityReport solved = viscosity_.apply(
      obstacles, {phi_.data(), phi_.size()}, const_faces(met_), k, cell_mass(), spans(u_),
      options.viscosity_tolerance, options.viscosity_iterations, options.threads);
  new_report_.viscosity_iterations = solved.iterations;
  new_report_.viscosity_converged = solved.converged;
  shear_ = viscosity_.exchanges(obstacles, cell_mass());
  if (!solved.finite) {
    throw NonFiniteError("the velocities or the viscosity are too large; take a shorter step",
                         time);
  }
  if (!solved.converged) {
    throw ConvergenceError("the viscosity was not solved for in " +
                               std::to_string(solved.iterations) +
                               " iterations; take a shorter step or less viscosity",
                           time);
  }
}

// A jet pulls on what comes out after it, but not out of the nozzle: the faces of the first cell
// keep its velocity.
template <class Real, int D>
void GridLiquid<Real, D>::hold_nozzles() {
  viscosity_.held.clear();
  for (const geometry::Emitter& tap : flow.emitters) {
    if (time < tap.start || time > tap.stop) continue;
    for (const Vec3& offset : tap.offsets) {
      for (const double cells : {0.25, 0.75}) {
        const Vec3 x = tap.position + offset + cells * options.cell * tap.direction;
        if (!is_inside(x)) continue;
        const std::int64_t i = cell_at(x);
        const std::array<int, D> cell = layout.cell(i);
        for (std::size_t a = 0; a < D; ++a) {
          const bool last = layout.periodic[a] && cell[a] + 1 == layout.cells[a];
          for (const std::int64_t face : {i, i + (last ? -cell[a] : 1) * layout.stride[a]}) {
            viscosity_.held.push_back({a, face});
            u_[a][usize(face)] = static_cast<Real>(tap.speed * tap.direction[int(a)]);
          }
        }
      }
    }
  }
}

template <class Real, int D>
void GridLiquid<Real, D>::push_obstacles(double dt) {
  push_surface(obstacles, projection_, {new_q_.data(), new_q_.size()}, dt * options.gravity,
               cell_mass(), options.threads);
  for (std::size_t c = 0; c < given_.size(); ++c) {
    if (responds(obstacles.colliders[c])) obstacles.colliders[c].set_exchange(given_[c]);
  }
  for (std::size_t c = 0; c < obstacles.colliders.size() && options.viscosity > 0; ++c) {
    shear_[c] += obstacles.colliders[c].exchange();
    obstacles.colliders[c].set_exchange(shear_[c]);
  }
  push_bodies();
}

// The velocities of bodies before any pressure.
template <class Real, int D>
void GridLiquid<Real, D>::reset_bodies() {
  for (std::size_t c = 0; c < free_motion_.size(); ++c) {
    geometry::Collider& collider = obstacles.colliders[c];
    if (collider.yields()) collider.set_body_velocity(free_motion_[c]);
  }
}

// The velocities of bodies as of all that they were given in the step, which is their sum.
template <class Real, int D>
void GridLiquid<Real, D>::push_bodies() {
  if (free_motion_.empty()) return;
  reset_bodies();
  geometry::push_bodies(obstacles.colliders);
}

// Faces whose velocities the pressure or a wall has set. What obstacles leave of a face may be so
// little that the velocity of what squeezes through says nothing of the flow.
template <class Real, int D>
void GridLiquid<Real, D>::find_valid() {
  constexpr Real kSmallest = 0.1;
  for (int a = 0; a < D; ++a) {
    const std::span<const Real> w = projection_.weight(a);
    const bool cut = obstacles.any();
    const std::span<const Real> open = cut ? obstacles.open(a) : w;
    for_numbers(layout.size, options.threads, [&](std::size_t i) {
      weight_[usize(a)][i] = cut && open[i] < kSmallest ? 0 : w[i];
    });
  }
  for_walls([&](std::size_t a, std::int64_t face) { weight_[a][usize(face)] = 1; });
}

// Finds the displacement, in shift_, that sets the density of full cells right: its divergence is
// the error, div d = rho / rho_0 - 1. Cells at the surface are full at most.
template <class Real, int D>
void GridLiquid<Real, D>::find_displacement() {
  // Of an error a step corrects a fifth: all of it stirs the liquid, as much of it is noise.
  // Beside obstacles counts are rough: of a lattice that a surface cuts by so much of a full one.
  constexpr Real kShare = 0.2, kMost = 0.5, kUnsure = 0.15;
  constexpr double kTolerance = 1e-2;
  constexpr int kIterations = 20;
  poll_interrupt();
  const std::span<const Cell> cells = projection_.cells();
  std::vector<double> errors(usize(layout.rows()));
  std::vector<std::int64_t> counts(usize(layout.rows()));
  parallel_for(
      layout.rows(), 8,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t r = begin; r < end; ++r) {
          const std::int64_t row = layout.row(r);
          for (std::int64_t i = row; i < row + layout.row_length(); ++i) {
            Real& error = density_[usize(i)];
            if (cells[usize(i)] != Cell::kFluid || (band && band->fills(i))) {
              error = 0;
              continue;
            }
            const bool inside = phi_[usize(i)] < -1;
            Real whole = error - 1;
            if (obstacles.any() && obstacles.room()[usize(i)] < 1) {
              const Real unsure = kUnsure / std::max(obstacles.room()[usize(i)], Real(kLeastRoom));
              whole -= std::clamp(whole, -unsure, unsure);
            }
            whole = std::clamp(whole, inside ? -kMost : Real(0), kMost);
            error = kShare * whole;
            if (obstacles.any())  // of the open part of the cell
              error *= std::clamp(obstacles.at_centre(i) + Real(0.5), Real(0), Real(1));
            if (!inside) continue;
            errors[usize(r)] += std::abs(double(whole));
            ++counts[usize(r)];
          }
        }
      },
      options.threads);
  const double error = std::accumulate(errors.begin(), errors.end(), 0.0);
  const auto count = std::accumulate(counts.begin(), counts.end(), std::int64_t{0});
  new_report_.mean_error = count > 0 ? error / static_cast<double>(count) : 0;
  const SolveReport solved =
      projection_.spread(obstacles, {density_.data(), density_.size()}, spans(shift_), kTolerance,
                         kIterations, options.threads);
  new_report_.volume_iterations = solved.iterations;
  if (options.viscosity > 0) find_valid();  // without, they are known from the velocities
  fill_around(shift_, 1);
}

template <class Real, int D>
void GridLiquid<Real, D>::move_obstacles(double dt) {
  for (geometry::Collider& collider : obstacles.colliders) collider.advance(dt);
  obstacles.find_distance(options.threads);  // all that particles ask for
}

template <class Real, int D>
std::int64_t GridLiquid<Real, D>::move(Particles<Real, D>& which, Transfer transfer, double dt) {
  poll_interrupt();
  Walls<Real> walls;
  walls.margin = walls.solid_margin = static_cast<Real>(kMargin);
  if (obstacles.any()) walls.solid = obstacles.distance().data();
  Move<Real, D> move;
  move.transfer = transfer;
  move.flip_ratio = static_cast<Real>(options.flip_rate);
  move.u = const_faces(u_);
  move.u_old = const_faces(old_u_);
  move.dx = static_cast<Real>(options.cell);
  move.dt = static_cast<Real>(dt);
  move.walls = walls;
  const std::int64_t bad = transfer_and_advect(which, layout, move, options.threads);
  if (bad >= 0 || !options.keep_volume) return bad;
  return displace(which, layout, const_faces(shift_), walls, options.threads);
}

template <class Real, int D>
void GridLiquid<Real, D>::move_particles(double dt) {
  const std::int64_t bad = move(next_, options.transfer, dt);
  if (bad >= 0) {
    throw NonFiniteError("the velocity of particle " + std::to_string(next_.id()[bad]) +
                             " is not finite; take a shorter step",
                         time, next_.id()[bad]);
  }
}

template <class Real, int D>
void GridLiquid<Real, D>::commit(double dt) noexcept {
  std::swap(particles, next_);
  if (kept_ && !kept_->stepped) std::swap(next_, kept_->particles), kept_->stepped = true;
  std::swap(flow.counts, new_counts_);
  if (band) band->commit();
  q.swap(new_q_);
  forces.clear();
  next_id = new_next_id_;
  report = new_report_;
  time += dt;
  last_dt = dt;
}

// Velocities of faces that are not known, from those around.
template <class Real, int D>
void GridLiquid<Real, D>::fill_around(Fields& u, int layers) {
  extrapolate_(layout, const_faces(weight_), faces(u), layers, options.threads);
}

template <class Real, int D>
ConstFaces<Real, D> GridLiquid<Real, D>::const_faces(const Fields& fields) {
  ConstFaces<Real, D> out;
  for (std::size_t a = 0; a < D; ++a) out[a] = fields[a].data();
  return out;
}

template <class Real, int D>
Faces<Real, D> GridLiquid<Real, D>::faces(Fields& fields) {
  Faces<Real, D> out;
  for (std::size_t a = 0; a < D; ++a) out[a] = fields[a].data();
  return out;
}

template <class Real, int D>
Velocity<Real, D> GridLiquid<Real, D>::spans(Fields& fields) {
  Velocity<Real, D> out;
  for (std::size_t a = 0; a < D; ++a) out[a] = {fields[a].data(), fields[a].size()};
  return out;
}

template class GridLiquid<float, 2>;
template class GridLiquid<float, 3>;
template class GridLiquid<double, 2>;
template class GridLiquid<double, 3>;

}  // namespace substep::gridfluid
