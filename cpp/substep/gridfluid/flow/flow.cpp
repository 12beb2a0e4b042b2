#include "substep/gridfluid/flow/flow.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/grid/text.h"

namespace substep::gridfluid {
namespace {

template <int D>
OpenSides<D> open_sides(const Sides<D>& sides) {
  OpenSides<D> open;
  for (std::size_t a = 0; a < D; ++a) {
    for (std::size_t end = 0; end < 2; ++end) open[a][end] = sides[a][end].kind == SideKind::kOpen;
  }
  return open;
}

std::vector<double> ambients(const FlowOptions& options) {
  std::vector<double> all;
  for (const ScalarOptions& scalar : options.scalars) all.push_back(scalar.ambient);
  return all;
}

}  // namespace

template <class Real, int D>
Flow<Real, D>::Flow(const Layout<D>& layout, const Vec3& low, double dx, const Sides<D>& sides,
                    std::vector<geometry::Collider> colliders_, std::vector<FlowSource> sources,
                    const FlowOptions& options_)
    : colliders(std::move(colliders_)),
      options(options_),
      layout_(layout),
      low_(low),
      dx_(dx),
      sides_(layout, sides, ambients(options_), dx),
      sources_(std::move(sources)),
      obstacles_(layout, low, dx, colliders),
      projection_(layout, open_sides<D>(sides), two_fluids()),
      face_diffusion_(D, Diffusion<Real, D>(layout)),
      cell_diffusion_(layout),
      paths_(layout) {
  for (Fields* fields : {&velocity_, &next_, &change_}) {
    for (AlignedBuffer<Real>& x : *fields) assign(x, layout.size, Real(0));
  }
  if (!colliders.empty()) {
    for (AlignedBuffer<Real>& x : held_) assign(x, layout.size, Real(0));
  }
  if (options.advection == FlowAdvection::kCentral || two_fluids()) {
    for (AlignedBuffer<Real>& x : given_) assign(x, layout.size, Real(0));
  }
  if (two_fluids()) assign(density_, layout.size, Real(1));
  assign(pressure_, layout.size, 0.0);
  assign(rates_, layout.size, Real(0));
  scalars_.resize(options.scalars.size());
  start_scalars_.resize(options.scalars.size());
  next_scalars_.resize(options.scalars.size());
  for (auto* fields : {&scalars_, &start_scalars_, &next_scalars_}) {
    for (AlignedBuffer<Real>& x : *fields) assign(x, layout.size, Real(0));
  }
  find_sources();
}

template <class Real, int D>
void Flow<Real, D>::step(double dt) {
  const double longest = longest_step();
  if (dt > longest) {
    throw SolverError("in a step of " + text(dt) + " s more diffuses than numbers can " +
                          "hold; take steps of at most " + text(longest) + " s, or dtype='float64'",
                      time);
  }
  new_report_ = {};
  start(dt);
  if (!has_fluid_) throw SolverError("obstacles leave no fluid in the box", time + dt);
  if (two_fluids()) carry_scalars(dt);
  if (options.advection == FlowAdvection::kCentral) {
    move_central(dt);
  } else {
    move_along_paths(dt);
  }
  drive_sources(next_);
  correct(dt);
  if (two_fluids()) {
    check_velocity();
  } else {
    carry_scalars(dt);
  }
  check_scalars();
  push(dt);
  keep(dt);
}

template <class Real, int D>
void Flow<Real, D>::project() {
  new_report_ = report;
  hold_sides();
  start(0);
  if (!has_fluid_) throw InputError("colliders: they leave no fluid in the box");
  for (std::size_t a = 0; a < D; ++a) copy(start_[a], next_[a], options.threads);
  for (std::size_t k = 0; k < scalars_.size(); ++k) {
    copy(scalars_[k], next_scalars_[k], options.threads);
  }
  drive_sources(next_);
  try {
    correct(0);
  } catch (const ConvergenceError&) {
    throw;
  } catch (const SolverError& error) {
    throw InputError(std::string("colliders: ") + error.what());
  }
  check_velocity();
  for (std::size_t a = 0; a < D; ++a) velocity_[a].swap(next_[a]);
  two_fluids() ? settle() : std::fill(pressure_.begin(), pressure_.end(), 0.0);
  report = new_report_;
}

template <class Real, int D>
void Flow<Real, D>::hold_sides() {
  if (!colliders.empty()) return;  // which may reach into sides: start() does it in the copy
  for (std::size_t a = 0; a < D; ++a) sides_.set_normal(span(velocity_[a]), a, options.threads);
}

// Obstacles where they are at the end of the step, and copies of the state that hold what is given
// at sides, in obstacles and in sources.
template <class Real, int D>
void Flow<Real, D>::start(double dt) {
  obstacles_.colliders = colliders;
  for (geometry::Collider& c : obstacles_.colliders) c.advance(dt);
  find_domain();
  const int threads = options.threads;
  for (std::size_t a = 0; a < D; ++a) {
    start_[a] = span(obstacles_.any() ? held_[a] : velocity_[a]);
    if (obstacles_.any()) {
      copy(velocity_[a], held_[a], threads);
      sides_.set_normal(start_[a], a, threads);
    }
    if (options.slip) {
      into_faces_[a].apply(layout_, start_[a]);
    } else {
      const int axis = static_cast<int>(a);
      for (const std::int64_t i : face_diffusion_[a].fixed()) {
        start_[a][usize(i)] = obstacles_.moving() ? obstacles_.velocity(axis)[usize(i)] : Real(0);
      }
    }
    sides_.fill(start_[a], a, threads);
  }
  for (std::size_t k = 0; k < scalars_.size(); ++k) {
    AlignedBuffer<Real>& x = start_scalars_[k];
    copy(scalars_[k], x, threads);
    for (std::size_t s = 0; s < sources_.size(); ++s) {
      const Real added = Real(sources_[s].rate[k] * dt);
      for (const std::int64_t i : places_[s].cells) {
        Real& there = x[usize(i)];
        there = sources_[s].held[k] ? Real(*sources_[s].held[k]) : there + added;
      }
    }
    into_cells_.apply(layout_, span(x));
    sides_.fill_scalar(span(x), k, options.scalars[k].diffusivity, start_, threads);
  }
  if (!needs_pressure()) return;
  const std::span<double> q = projection_.q();
  const double scale = dt / dx_;
  for_numbers(layout_.size, threads, [&](std::size_t i) { q[i] = pressure_[i] * scale; });
  into_cells_.apply(layout_, q);
  wrap(layout_, q, threads);
  fall_ = options.gravity * dt;
  if (two_fluids()) find_density(span(scalars_[usize(options.smoke)]));
}

template <class Real, int D>
void Flow<Real, D>::find_domain() {
  std::vector<std::array<double, geometry::Collider::kStateSize>> states;
  for (const geometry::Collider& c : obstacles_.colliders) states.push_back(c.state());
  if (found_any_ && states == found_) return;
  found_any_ = false;
  const int threads = options.threads;
  obstacles_.find(threads);
  projection_.set_domain(obstacles_, {}, threads);
  has_fluid_ = std::any_of(projection_.cells().begin(), projection_.cells().end(),
                           [](Cell cell) { return cell == Cell::kFluid; });
  for (std::size_t a = 0; a < D; ++a) {
    face_diffusion_[a].find_faces(sides_, obstacles_, a, options.slip, threads);
    if (options.slip) {
      into_faces_[a].find(layout_, sides_.free_faces(a), face_diffusion_[a].fixed(), 3);
    }
  }
  cell_diffusion_.find_cells(obstacles_, projection_.cells(), threads);
  into_cells_.find(layout_, all_cells(layout_), cell_diffusion_.fixed(), 3);
  stress_.find(layout_, obstacles_, projection_.cells(), threads);
  found_ = std::move(states);
  found_any_ = true;
}

template <class Real, int D>
void Flow<Real, D>::find_sources() {
  const auto within = [&](const FlowSource& source, const std::array<int, D>& cell, int faces_of) {
    Vec3 x = low_;
    for (std::size_t a = 0; a < D; ++a) {
      const double half = static_cast<int>(a) == faces_of ? 0 : 0.5;
      x[static_cast<int>(a)] += dx_ * (cell[a] + half);
    }
    return source.region.signed_distance(x).value <= 0;
  };
  for (const FlowSource& source : sources_) {
    SourcePlaces places;
    poll_interrupt();
    const auto find = [&](const Block<D>& block, int faces_of, std::vector<std::int64_t>& found) {
      std::array<int, D> cell = block.from;
      do {
        if (within(source, cell, faces_of)) found.push_back(layout_.index(cell));
      } while (next_in_block(cell, block.from, block.to));
    };
    find(all_cells(layout_), -1, places.cells);
    for (std::size_t a = 0; a < D && source.velocity; ++a) {
      find(sides_.free_faces(a), static_cast<int>(a), places.faces[a]);
    }
    places_.push_back(std::move(places));
  }
}

template <class Real, int D>
void Flow<Real, D>::drive_sources(Fields& fields) {
  for (std::size_t s = 0; s < sources_.size(); ++s) {
    if (!sources_[s].velocity) continue;
    for (std::size_t a = 0; a < D; ++a) {
      const Real v = Real((*sources_[s].velocity)[static_cast<int>(a)]);
      for (const std::int64_t i : places_[s].faces[a]) {
        fields[a][usize(i)] = v;
        if (!predicts()) take_pressure(a, i, i + 1, 1, span(fields[a]));
      }
    }
  }
}

// The pressure of the step before is given back, if it was taken, and found anew with it as the
// first guess.
template <class Real, int D>
void Flow<Real, D>::correct(double dt) {
  check_inflow();
  if (predicts()) take_pressure(next_, Real(1));
  if (two_fluids()) weigh();
  for (std::size_t a = 0; a < D; ++a) wrap(layout_, span(next_[a]), options.threads);
  const double divergence = obstacles_.any() ? total_divergence(next_) : 0;
  const SolveReport got = projection_.project(obstacles_, spans(next_), options.tolerance,
                                              options.max_iterations, options.threads);
  new_report_.solver = got.direct                                         ? "transform"
                       : got.preconditioner == Preconditioner::kMultigrid ? "multigrid"
                                                                          : "diagonal";
  new_report_.iterations = got.iterations;
  new_report_.residual = got.residual;
  new_report_.converged = got.converged && std::isfinite(got.residual);
  if (!new_report_.converged) {
    if (!std::isfinite(got.residual)) check_velocity();
    throw ConvergenceError("the pressure did not converge: after " +
                               std::to_string(got.iterations) + " iterations its residual is " +
                               text(got.residual) +
                               "; take shorter steps, a larger tolerance or more iterations",
                           time + dt);
  }
  check_regions(got, divergence, dt);
}

// Obstacles may close regions of their own, and squeeze them. What their surfaces are taken for
// does not quite keep its volume when they turn, so that a little is no error.
template <class Real, int D>
void Flow<Real, D>::check_regions(const SolveReport& got, double divergence, double dt) const {
  constexpr double kMost = 0.05;
  if (got.closed_regions == 0 || got.imbalance <= kMost) return;
  const double net = got.imbalance * divergence, fastest = limits().courant;
  double theirs = 0;
  for (const geometry::Collider& c : obstacles_.colliders) {
    theirs = std::max(theirs, c.velocity.norm());
  }
  if (net <= kMost * std::max(fastest, theirs)) return;
  throw SolverError("in a region that is closed " + text(net * std::pow(dx_, D - 1)) +
                        (D == 2 ? " m^2/s" : " m^3/s") +
                        " more flow in than out; obstacles cannot compress a closed region",
                    time + dt);
}

template <class Real, int D>
double Flow<Real, D>::total_divergence(const Fields& u) const {
  const bool moving = obstacles_.moving();
  return sum_rows(
      layout_, all_cells(layout_), options.threads, [&](std::int64_t begin, std::int64_t end) {
        double sum = 0;
        for (std::int64_t i = begin; i < end; ++i) {
          if (projection_.cells()[usize(i)] != Cell::kFluid) continue;
          double of_cell = 0;
          for (std::size_t a = 0; a < D; ++a) {
            const int axis = static_cast<int>(a);
            const auto flux = [&](std::int64_t f) {
              const double open = double(obstacles_.open(axis)[usize(f)]);
              const double theirs = moving ? double(obstacles_.displacing(axis)[usize(f)]) : 0;
              return open * double(u[a][usize(f)]) + (1 - open) * theirs;
            };
            of_cell += flux(i + layout_.stride[a]) - flux(i);
          }
          sum += std::abs(of_cell);
        }
        return sum;
      });
}

template <class Real, int D>
void Flow<Real, D>::check_inflow() const {
  double net = 0, all = 0;
  for (std::size_t a = 0; a < D; ++a) {
    for (std::size_t end = 0; end < 2; ++end) {
      if (sides_.is(a, end, SideKind::kOpen)) return;
      if (!sides_.is(a, end, SideKind::kInflow)) continue;
      Block<D> side = all_faces(layout_, a);
      (end == 0 ? side.to[a] : side.from[a]) = end == 0 ? 1 : layout_.cells[a];
      std::array<int, D> cell = side.from;
      do {
        const std::size_t i = usize(layout_.index(cell));
        const double part = obstacles_.any() ? double(obstacles_.open(static_cast<int>(a))[i]) : 1;
        const double in = part * sides_.given(a, end, cell, a) * (end == 0 ? 1 : -1);
        net += in, all += std::abs(in);
      } while (next_in_block(cell, side.from, side.to));
    }
  }
  if (std::abs(net) <= 1e-5 * all) return;
  const double flow = net * std::pow(dx_, D - 1);
  throw InputError("sides: " + text(flow) + (D == 2 ? " m^2/s" : " m^3/s") +
                   " more flow into the closed box than out; open a side, or let as much flow out");
}

template <class Real, int D>
void Flow<Real, D>::check_velocity() const {
  for (std::size_t a = 0; a < D; ++a) {
    const auto wrong = [&](std::int64_t begin, std::int64_t end) {
      return first_wrong(next_[a], begin, end);
    };
    refuse_wrong("the velocity", gather_rows(layout_, all_faces(layout_, a), options.threads,
                                             std::int64_t{-1}, wrong, keep_first));
  }
}

template <class Real, int D>
void Flow<Real, D>::check_scalars() const {
  for (const AlignedBuffer<Real>& x : next_scalars_) {
    const auto wrong = [&](std::int64_t begin, std::int64_t end) {
      return first_wrong(x, begin, end);
    };
    refuse_wrong("what the flow carries", gather_rows(layout_, all_cells(layout_), options.threads,
                                                      std::int64_t{-1}, wrong, keep_first));
  }
}

// i: of a cell or a face that is not finite; -1: none.
template <class Real, int D>
void Flow<Real, D>::refuse_wrong(const char* what, std::int64_t i) const {
  if (i < 0) return;
  std::int64_t number = 0;  // of the cell, in C order
  const std::array<int, D> cell = layout_.cell(i);
  for (std::size_t a = 0; a < D; ++a) {
    number = number * layout_.cells[a] + std::min(cell[a], layout_.cells[a] - 1);
  }
  throw NonFiniteError(std::string(what) + " at cell " + std::to_string(number) +
                           " is not finite; take shorter steps",
                       time, number);
}

template <class Real, int D>
void Flow<Real, D>::push(double dt) {
  if (!obstacles_.any()) return;
  for (std::size_t a = 0; a < D; ++a) sides_.fill(span(next_[a]), a, options.threads);
  const double courant = dt / dx_;
  const auto pull = [&](std::int64_t i, std::size_t a) {
    double sum = 0;
    for (std::size_t k = 0; k < scalars_.size(); ++k) {
      const auto& o = options.scalars[k];
      sum += o.buoyancy * (double(next_scalars_[k][usize(i)]) - o.ambient);
    }
    const double fall = dt * options.gravity[static_cast<int>(a)];
    return two_fluids() ? fall * (1 - 1 / double(density_[usize(i)])) : -fall * sum;
  };
  stress_.push(layout_, obstacles_, projection_.cells(),
               {.before = spans(velocity_),
                .after = spans(next_),
                .q = projection_.q(),
                .density = {density_.data(), density_.size()},
                .mass = mass(),
                .courant = courant,
                .shear = options.viscosity * courant / dx_,
                .pull = pull},
               options.threads);
}

// From here on nothing fails. A step may be so short that its pressure is no number: then it stays.
template <class Real, int D>
void Flow<Real, D>::keep(double dt) {
  const DeferInterrupts deferred;
  for (std::size_t a = 0; a < D; ++a) velocity_[a].swap(next_[a]);
  scalars_.swap(next_scalars_);
  const std::span<const double> q = projection_.q();
  const std::span<const Cell> cells = projection_.cells();
  const double scale = dx_ / dt;
  for_numbers(layout_.size, options.threads, [&](std::size_t i) {
    const double p = q[i] * scale, there = std::isfinite(p) ? p : pressure_[i];
    pressure_[i] = cells[i] == Cell::kFluid ? there : 0.0;
  });
  for (std::size_t c = 0; c < colliders.size(); ++c) colliders[c] = obstacles_.colliders[c];
  time += dt;
  report = new_report_;
}

template <class Real, int D>
double Flow<Real, D>::mass() const {
  return options.density * std::pow(dx_, D);  // in 2D of a layer of 1 m
}

template <class Real, int D>
Velocity<Real, D> Flow<Real, D>::spans(Fields& fields) {
  Velocity<Real, D> u;
  for (std::size_t a = 0; a < D; ++a) u[a] = span(fields[a]);
  return u;
}

template class Flow<float, 2>;
template class Flow<float, 3>;
template class Flow<double, 2>;
template class Flow<double, 3>;

}  // namespace substep::gridfluid
