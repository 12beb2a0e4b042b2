// What moves the velocities of a flow, and what it carries.
#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "substep/core/usize.h"
#include "substep/gridfluid/flow/central.h"
#include "substep/gridfluid/flow/confinement.h"
#include "substep/gridfluid/flow/flow.h"
#include "substep/gridfluid/flow/runge_kutta.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {

// Whether a step begins with the pressure of the step before: without viscosity nothing comes
// between its advection along paths and the projection, which would take it back at once.
template <class Real, int D>
bool Flow<Real, D>::predicts() const {
  return options.advection == FlowAdvection::kCentral || options.viscosity > 0;
}

// To predict, to drive sources, or as the first guess of an iteration.
template <class Real, int D>
bool Flow<Real, D>::needs_pressure() const {
  return predicts() || !projection_.direct() ||
         std::any_of(sources_.begin(), sources_.end(),
                     [](const FlowSource& source) { return source.velocity.has_value(); });
}

// u += factor grad q, where and as the projection takes it; of two fluids with their weight.
template <class Real, int D>
void Flow<Real, D>::take_pressure(Fields& fields, Real factor) {
  for (std::size_t a = 0; a < D; ++a) {
    for_rows(layout_, sides_.free_faces(a), options.threads,
             [&](std::int64_t begin, std::int64_t end) {
               take_pressure(a, begin, end, factor, span(fields[a]));
             });
  }
}

template <class Real, int D>
void Flow<Real, D>::take_pressure(std::size_t a, std::int64_t begin, std::int64_t end, Real factor,
                                  std::span<Real> x) const {
  projection_.add_gradient(obstacles_, a, begin, end, factor, x);
  if (two_fluids()) add_weight(a, begin, end, -factor, x);
}

// Adds the change of velocities that a step brings beside advection and viscosity, of what it
// begins with: buoyancy, confinement, the pressure of the step before.
template <class Real, int D>
void Flow<Real, D>::add_given(Fields& fields, double dt) {
  for (std::size_t a = 0; a < D; ++a) {
    const std::int64_t s = layout_.stride[a];
    const double pull = -options.gravity[static_cast<int>(a)] * dt;
    for (std::size_t n = 0; n < scalars_.size(); ++n) {
      const ScalarOptions& o = options.scalars[n];
      const Real half = Real(pull * o.buoyancy) / 2, ambient = Real(2 * o.ambient);
      if (half == 0) continue;
      const std::span<Real> x = span(start_scalars_[n]), given = span(fields[a]);
      for_rows(layout_, sides_.free_faces(a), options.threads,
               [&](std::int64_t begin, std::int64_t end) {
                 for (std::int64_t i = begin; i < end; ++i) {
                   given[usize(i)] += half * (x[usize(i - s)] + x[usize(i)] - ambient);
                 }
               });
    }
  }
  for (std::size_t a = 0; a < D && two_fluids() && options.viscosity > 0; ++a) {
    add_stress(span(fields[a]), a, number(options.viscosity, dt));
  }
  if (options.vorticity_confinement > 0) {
    Confinement<Real, D>::add(layout_, sides_, start_, options.vorticity_confinement * dt / dx_,
                              spans(fields), spans(change_), span(rates_), options.threads);
  }
  if (predicts()) take_pressure(fields, Real(-1));
}

// Velocities that obstacles hold do not change with the flow.
template <class Real, int D>
void Flow<Real, D>::hold(std::size_t a, std::span<Real> x) const {
  for (const std::int64_t i : face_diffusion_[a].fixed()) x[usize(i)] = 0;
}

// Of the implicit part of viscosity: half for second order, more where modes would keep more than
// half of their amplitude with the sign changed.
template <class Real, int D>
double Flow<Real, D>::implicit_part(double number) const {
  const double stiffest = 4 * D * number;
  return stiffest > 0 ? std::max(0.5, 2.0 / 3 - 1 / stiffest) : 0.5;
}

template <class Real, int D>
void Flow<Real, D>::solve(Diffusion<Real, D>& diffusion, double k, std::span<Real> d,
                          std::size_t of) {
  const auto refill = [&](std::span<Real> x) {
    if (of < D) {
      sides_.fill_change(x, of, options.threads);
    } else {
      sides_.fill_scalar_change(x, of - D, carrying(), options.threads);
    }
  };
  const DiffusionReport got = diffusion.solve(Real(k), d, refill, options.viscosity_tolerance,
                                              options.viscosity_iterations, options.threads);
  new_report_.viscosity_iterations += got.iterations;
  new_report_.viscosity_converged &= got.converged;
}

template <class Real, int D>
void Flow<Real, D>::move_central(double dt) {
  const double k = number(options.viscosity, dt), part = implicit_part(k);
  const int threads = options.threads;
  for (std::size_t a = 0; a < D; ++a) {
    const std::span<Real> given = span(given_[a]);
    if (k > 0) face_diffusion_[a].apply(start_[a], given, threads);
    for_rows(layout_, sides_.free_faces(a), threads, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        given[usize(i)] = k > 0 ? Real(k) * given[usize(i)] : Real(0);
      }
    });
  }
  add_given(given_, dt);
  std::vector<Changing<Real, D>> arrays;
  for (std::size_t a = 0; a < D; ++a) {
    hold(a, span(given_[a]));
    copy(start_[a], next_[a], threads);
    arrays.push_back(
        {sides_.free_faces(a), start_[a], span(given_[a]), span(next_[a]), span(change_[a])});
  }
  constexpr double kStiff = 0.2;  // explicit stages are stable below it
  const Velocity<Real, D> stage = spans(next_);
  find_passing(stage);  // makes the arrays
  const Velocity<Real, D> passing = obstacles_.any() ? spans(passing_) : stage;
  runge_kutta<Real, D>(
      layout_, arrays, Real(dt / dx_), span(rates_),
      [&](std::size_t a, std::span<Real> out) {
        if (a == 0) find_passing(stage);
        Fluxes<Real, D>::central(layout_, sides_, passing, stage, a, out, threads);
      },
      [&](std::size_t a, std::span<Real> d) {
        hold(a, d);
        if (k > kStiff) solve(face_diffusion_[a], part * k, d, a);
      },
      [&](std::size_t a, std::span<Real> x) { sides_.fill(x, a, threads); }, threads);
  for (std::size_t a = 0; a < D; ++a) {
    const std::span<Real> d = span(change_[a]), x = span(next_[a]);
    hold(a, d);
    if (k > 0) solve(face_diffusion_[a], part * k, d, a);
    for_rows(layout_, sides_.free_faces(a), threads, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        x[usize(i)] = start_[a][usize(i)] + d[usize(i)];
      }
    });
  }
}

// What passes faces of which obstacles leave a part.
template <class Real, int D>
void Flow<Real, D>::find_passing(const Velocity<Real, D>& u) {
  if (!obstacles_.any()) return;
  const bool moving = obstacles_.moving();
  for (std::size_t a = 0; a < D; ++a) {
    if (passing_[a].size() == 0) assign(passing_[a], layout_.size, Real(0));
    const std::span<Real> v = span(passing_[a]);
    const int axis = static_cast<int>(a);
    for_rows(layout_, all_faces(layout_, a), options.threads,
             [&](std::int64_t begin, std::int64_t end) {
               for (std::int64_t i = begin; i < end; ++i) {
                 const Real open = obstacles_.open(axis)[usize(i)];
                 const Real theirs = moving ? obstacles_.displacing(axis)[usize(i)] : Real(0);
                 v[usize(i)] = open * u[a][usize(i)] + (1 - open) * theirs;
               }
             });
    wrap(layout_, v, options.threads);
  }
}

template <class Real, int D>
void Flow<Real, D>::move_along_paths(double dt) {
  const int threads = options.threads;
  const auto refill = [&](std::size_t a) {
    return [this, a, threads](std::span<Real> x) {
      sides_.set_normal(x, a, threads);
      sides_.fill(x, a, threads);
    };
  };
  paths_.follow(start_, dt / dx_, options.advection == FlowAdvection::kMacCormack, threads);
  for (std::size_t a = 0; a < D; ++a) {
    paths_.advect(static_cast<int>(a), sides_.free_faces(a), start_[a], span(next_[a]), refill(a),
                  threads);
  }
  add_given(next_, dt);
  const double k = number(options.viscosity, dt);
  for (std::size_t a = 0; a < D; ++a) {
    const std::span<Real> x = span(next_[a]);
    sides_.set_normal(x, a, threads);
    for (const std::int64_t i : face_diffusion_[a].fixed()) x[usize(i)] = start_[a][usize(i)];
    if (k == 0) continue;
    refill(a)(x);
    diffuse(face_diffusion_[a], k, x, span(change_[a]), a);
  }
}

// x += d, the change by implicit diffusion of all of it.
template <class Real, int D>
void Flow<Real, D>::diffuse(Diffusion<Real, D>& diffusion, double k, std::span<Real> x,
                            std::span<Real> d, std::size_t of) {
  diffusion.apply(x, d, options.threads);
  const auto each = [&](const auto& put) {
    for_rows(layout_, diffusion.block(), options.threads,
             [&](std::int64_t begin, std::int64_t end) {
               for (std::int64_t i = begin; i < end; ++i) put(usize(i));
             });
  };
  each([&](std::size_t i) { d[i] *= Real(k); });
  solve(diffusion, k, d, of);
  each([&](std::size_t i) { x[i] += d[i]; });
}

template <class Real, int D>
void Flow<Real, D>::carry_scalars(double dt) {
  if (scalars_.empty()) return check_velocity();
  const bool central = options.advection == FlowAdvection::kCentral || two_fluids();
  // By the mean of velocities before and after, checked too; but what pulls on the flow by those
  // after, so that waves neither grow nor die by the step.
  const bool pulls = options.gravity.norm() > 0 &&
                     std::any_of(options.scalars.begin(), options.scalars.end(),
                                 [](const ScalarOptions& o) { return o.buoyancy != 0; });
  const Real before = pulls ? 0 : 0.5, after = 1 - before;
  for (std::size_t a = 0; a < D && !two_fluids(); ++a) {
    const std::span<Real> mean = span(change_[a]);
    const auto of_row = [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        mean[usize(i)] = before * start_[a][usize(i)] + after * next_[a][usize(i)];
      }
      return first_wrong(next_[a], begin, end);
    };
    refuse_wrong("the velocity", gather_rows(layout_, all_faces(layout_, a), options.threads,
                                             std::int64_t{-1}, of_row, keep_first));
    if (central) continue;
    if (options.slip) into_faces_[a].apply(layout_, mean);
    sides_.fill(mean, a, options.threads);
  }
  if (!central) {
    paths_.follow(spans(change_), dt / dx_, options.advection == FlowAdvection::kMacCormack,
                  options.threads);
  }
  for (std::size_t k = 0; k < scalars_.size(); ++k) {
    central ? carry_limited(k, dt) : carry_along_paths(k, dt);
  }
}

template <class Real, int D>
void Flow<Real, D>::carry_limited(std::size_t k, double dt) {
  const double diffusivity = options.scalars[k].diffusivity;
  const double n = number(diffusivity, dt), part = implicit_part(n);
  const Velocity<Real, D> u = carrying();
  const std::span<Real> given = span(given_[0]), change = span(given_[1]);  // not needed any more
  const std::span<Real> next = span(next_scalars_[k]);
  const auto start = span(std::as_const(start_scalars_[k]));
  const int threads = options.threads;
  copy(start_scalars_[k], next_scalars_[k], threads);
  if (n > 0) cell_diffusion_.apply(start, given, threads);
  for_numbers(layout_.size, threads,
              [&](std::size_t i) { given[i] = n > 0 ? Real(n) * given[i] : Real(0); });
  std::array<std::span<const Real>, D> open;
  for (int a = 0; a < D && obstacles_.any(); ++a) open[usize(a)] = obstacles_.open(a);
  const std::array<Changing<Real, D>, 1> arrays{{{all_cells(layout_), start, given, next, change}}};
  const auto fix = [&](std::span<Real> d) {
    for (const std::int64_t i : cell_diffusion_.fixed()) d[usize(i)] = 0;
  };
  constexpr double kStiff = 0.2;
  runge_kutta<Real, D>(
      layout_, arrays, Real(dt / dx_), span(rates_),
      [&](std::size_t, std::span<Real> out) {
        Fluxes<Real, D>::limited(layout_, u, open, next, out, threads);
      },
      [&](std::size_t, std::span<Real> d) {
        fix(d);
        if (n > kStiff) solve(cell_diffusion_, part * n, d, D + k);
      },
      [&](std::size_t, std::span<Real> x) { sides_.fill_scalar(x, k, diffusivity, u, threads); },
      threads);
  fix(change);
  if (n > 0) solve(cell_diffusion_, part * n, change, D + k);
  for_rows(layout_, all_cells(layout_), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      next[usize(i)] = start[usize(i)] + change[usize(i)];
    }
  });
}

template <class Real, int D>
void Flow<Real, D>::carry_along_paths(std::size_t k, double dt) {
  const double diffusivity = options.scalars[k].diffusivity, n = number(diffusivity, dt);
  const Velocity<Real, D> u = spans(change_);
  const std::span<Real> start = span(start_scalars_[k]), next = span(next_scalars_[k]);
  const auto refill = [&](std::span<Real> x) {
    into_cells_.apply(layout_, x);
    sides_.fill_scalar(x, k, diffusivity, u, options.threads);
  };
  refill(start);
  paths_.advect(-1, all_cells(layout_), start, next, refill, options.threads);
  if (n == 0) return;
  refill(next);
  diffuse(cell_diffusion_, n, next, span(rates_), D + k);
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                             \
  template bool Flow<Real, D>::predicts() const;                                                 \
  template bool Flow<Real, D>::needs_pressure() const;                                           \
  template void Flow<Real, D>::take_pressure(Fields&, Real);                                     \
  template void Flow<Real, D>::take_pressure(std::size_t, std::int64_t, std::int64_t, Real,      \
                                             std::span<Real>) const;                             \
  template void Flow<Real, D>::add_given(Fields&, double);                                       \
  template void Flow<Real, D>::hold(std::size_t, std::span<Real>) const;                         \
  template double Flow<Real, D>::implicit_part(double) const;                                    \
  template void Flow<Real, D>::solve(Diffusion<Real, D>&, double, std::span<Real>, std::size_t); \
  template void Flow<Real, D>::find_passing(const Velocity<Real, D>&);                           \
  template void Flow<Real, D>::move_central(double);                                             \
  template void Flow<Real, D>::move_along_paths(double);                                         \
  template void Flow<Real, D>::diffuse(Diffusion<Real, D>&, double, std::span<Real>,             \
                                       std::span<Real>, std::size_t);                            \
  template void Flow<Real, D>::carry_scalars(double);                                            \
  template void Flow<Real, D>::carry_limited(std::size_t, double);                               \
  template void Flow<Real, D>::carry_along_paths(std::size_t, double);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::gridfluid
