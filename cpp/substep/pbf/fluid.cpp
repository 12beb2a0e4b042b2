#include "substep/pbf/fluid.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/pbf/sums.h"

namespace substep::pbf {
namespace {

constexpr std::int64_t kRows = 4096;  // that a task works on

// The lowest i in [0, n) with test(i), or -1.
template <class Test>
std::int64_t first_where(std::int64_t n, int threads, const Test& test) {
  std::vector<std::int64_t> found(usize((n + kRows - 1) / kRows), -1);
  parallel_for(
      n, kRows,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          if (test(i)) {
            found[begin / kRows] = i;
            return;
          }
        }
      },
      threads);
  for (const std::int64_t i : found) {
    if (i >= 0) return i;
  }
  return -1;
}

// Cells are numbered by integers that Real holds exactly; a margin is left for one step's sweeps.
template <class Real>
double reach(double radius) {
  return (std::is_same_v<Real, float> ? 0x1p23 : 0x1p52) * radius;
}

}  // namespace

template <class Real>
Fluid<Real>::Fluid(const Vec3& origin_, std::vector<geometry::Collider> colliders,
                   const FluidOptions& options_, geometry::ParticleFlow flow_)
    : options(options_),
      origin(origin_),
      density(options.density),
      boundary(std::move(colliders), flow_.emitters, density, origin, options.threads),
      flow(std::move(flow_)),
      neighbours_(options.density.dimension) {}

template <class Real>
Real Fluid<Real>::inverse_mass(std::int32_t fluid) const {
  return static_cast<Real>(options.masses[0] / options.masses[usize(fluid)]);
}

template <class Real>
Point<Real> Fluid<Real>::local(const Vec3& x, Real w) const {
  const Vec3 from = x - origin;
  return {static_cast<Real>(from.x()), static_cast<Real>(from.y()), static_cast<Real>(from.z()), w};
}

template <class Real>
void Fluid<Real>::check_reach(std::span<const Vec3> x) const {
  const double limit = reach<Real>(density.radius());
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (!((x[i] - origin).cwiseAbs().maxCoeff() <= limit)) {
      throw InputError("positions[" + std::to_string(i) + "]: expected a point within " +
                       std::to_string(limit) + " m (2^23 supports, 2^52 in float64) of the first");
    }
  }
}

template <class Real>
std::int64_t Fluid<Real>::add(std::span<const Vec3> x, std::span<const Vec3> v,
                              std::span<const std::int32_t> fluid) {
  append(particles, next_id, x, v, fluid);
  return std::exchange(next_id, next_id + static_cast<std::int64_t>(x.size()));
}

template <class Real>
void Fluid<Real>::append(Particles<Real>& to, std::int64_t first_id, std::span<const Vec3> x,
                         std::span<const Vec3> v, std::span<const std::int32_t> fluid) const {
  check_reach(x);
  const std::int64_t old = to.size();
  const bool forces = !to.f.empty();
  to.resize(old + static_cast<std::int64_t>(x.size()), forces);
  for (std::size_t k = 0; k < x.size(); ++k) {
    const auto i = usize(old) + k;
    to.x[i] = local(x[k], inverse_mass(fluid[k]));
    to.v[i] = {static_cast<Real>(v[k].x()), static_cast<Real>(v[k].y()),
               static_cast<Real>(v[k].z()), 0};
    if (forces) to.f[i] = {0, 0, 0, 0};
    to.id[i] = first_id + static_cast<std::int64_t>(k);
    to.fluid[i] = fluid[k];
  }
}

template <class Real>
void Fluid<Real>::remove(std::span<const std::uint8_t> flags) {
  particles.erase({flags.begin(), flags.end()});
}

// Takes out what lies inside; returns how many.
template <class Real>
std::int64_t Fluid<Real>::absorb(Particles<Real>& from, const geometry::Collider& region) const {
  const std::int64_t n = from.size();
  std::vector<std::uint8_t> inside(usize(n));
  parallel_for(
      n, kRows,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          inside[i] = region.signed_distance(world(from.x[i])).value < 0 ? 1 : 0;
        }
      },
      options.threads);
  if (std::find(inside.begin(), inside.end(), 1) != inside.end()) from.erase(inside);
  return n - from.size();
}

template <class Real>
void Fluid<Real>::step(double dt) {
  flow.check(time + dt);
  std::vector<geometry::Collider> colliders = boundary.colliders();
  std::vector<Point<Real>> before;
  new_report_ = {};
  try {
    if (begin(dt)) {
      before = particles.x;
      boundary.colliders() = colliders;
      uncover(dt);
      boundary.colliders() = colliders;
      begin(dt);
    }
    if (options.divergence_free) {
      correct(dt);
      accelerate(dt);
      act_on_velocities(dt);
      project(dt);
    } else {
      warm_start(dt);
      solve(options.tolerance, options.max_tolerance);
      finish(dt);
      act_on_velocities(dt);
    }
    keep_in_bounds();
    let_flow(time + dt);
  } catch (...) {
    boundary.colliders().swap(colliders);
    if (!before.empty()) particles.x.swap(before);
    throw;
  }
  commit(dt);
}

// Whether obstacles cover particles as the step begins.
template <class Real>
bool Fluid<Real>::begin(double dt) {
  predict(dt);
  keep_in_reach();
  sort();
  if (!options.divergence_free) {
    forces_.pull_together(options.forces, rows(), options.masses[0], dt * dt, next_.x, next_.x);
  }
  boundary.place_layers(flow.counts.layers, time + dt);
  boundary.set_share(1);
  if (!options.divergence_free) geometry::accelerate_bodies(boundary.colliders(), dt);
  const bool covered = boundary.begin_step(dt, old_x_, std::span(next_.x).first(old_x_.size()),
                                           mass_, options.masses[0], options.threads);
  if (options.divergence_free) keep_velocities(dt);
  return covered;
}

// Velocities are those of before, but for what obstacles that were met did.
template <class Real>
void Fluid<Real>::keep_velocities(double dt) {
  const std::span<const std::int32_t> order = neighbours_.order();
  const auto rate = static_cast<Real>(1 / dt);
  for_particles(
      next_.size(),
      [&](std::int64_t k) {
        const std::int32_t i = order[usize(k)];
        const Point<Real>&x = next_.x[usize(k)], &wanted = predicted_[usize(i)],
              &start = old_x_[usize(k)], &before = particles.x[usize(i)], &v = old_v_[usize(k)];
        const auto met = [&](Real to, Real from, Real set_off, Real stood) {
          return rate * ((to - from) - (set_off - stood));
        };
        next_.v[usize(k)] = {v.x + met(x.x, wanted.x, start.x, before.x),
                             v.y + met(x.y, wanted.y, start.y, before.y),
                             v.z + met(x.z, wanted.z, start.z, before.z), 0};
      },
      options.threads);
}

// Obstacles were put upon particles: sets them off, and all apart that are then too near to each
// other, by positions alone, so that nothing flies off (the pre-stabilization of Macklin et al.,
// "Unified particle physics for real-time applications", 2014, section 4.4). Ten times closer than
// a step, which makes velocities of what is left; and the rounds that it takes grow with the square
// of the number of layers that are to move.
template <class Real>
void Fluid<Real>::uncover(double dt) {
  constexpr int kMost = 500;  // times that neighbours are looked for
  constexpr double kCloser = 0.1, kMean = 1e-4, kMax = 1e-3;
  for (geometry::Collider& collider : boundary.colliders()) {
    collider.velocity = collider.angular_velocity = Vec3::Zero();
    collider.body.number = -1;
  }
  const double tolerance = std::max(kCloser * options.tolerance, kMean);
  const double max_tolerance = std::max(kCloser * options.max_tolerance, kMax);
  bool apart = false;
  for (int k = 0; k < kMost && !apart; ++k) {
    new_report_ = {};
    predicted_ = particles.x;
    sort();
    boundary.place_layers(flow.counts.layers, time);
    const std::span<Point<Real>> rows(next_.x), x = rows.first(rows.size() - 1);
    const bool covered =
        boundary.begin_step(dt, old_x_, x, mass_, options.masses[0], options.threads);
    if (!covered) {  // else they have other neighbours now
      const auto walls = boundary.contributions(x, options.threads);
      const DensityError error =
          density.multipliers(rows, neighbours_, walls, multipliers_, options.threads);
      apart = error.mean <= tolerance && error.max <= max_tolerance;
      if (!apart) solve(tolerance, max_tolerance);
    }
    const std::span<const std::int32_t> order = neighbours_.order();
    for (std::size_t i = 0; i < order.size(); ++i) particles.x[usize(order[i])] = next_.x[i];
  }
  new_report_ = {};
}

// x* = x + dt v, v += dt (g + f / m).
template <class Real>
void Fluid<Real>::predict(double dt) {
  const std::int64_t n = particles.size();
  predicted_.resize(usize(n));
  const double m0 = options.masses[0];
  parallel_for(
      n, kRows,
      [&](std::int64_t begin, std::int64_t end) {
        const auto h = static_cast<Real>(dt);
        const Point<Real> g = gravity();
        for (std::int64_t i = begin; i < end; ++i) {
          const Point<Real>&x = particles.x[i], &v = particles.v[i];
          if (options.divergence_free) {  // accelerations come at the end, before the pressure
            predicted_[i] = {x.x + h * v.x, x.y + h * v.y, x.z + h * v.z, x.w};
            continue;
          }
          Point<Real> a = g;
          if (!particles.f.empty()) {
            const Point<Real>& f = particles.f[i];
            const Real w = x.w / static_cast<Real>(m0);
            a = {g.x + w * f.x, g.y + w * f.y, g.z + w * f.z, 0};
          }
          predicted_[i] = {x.x + h * (v.x + h * a.x), x.y + h * (v.y + h * a.y),
                           x.z + h * (v.z + h * a.z), x.w};
        }
      },
      options.threads);
}

// Refuses positions that the search cannot number.
template <class Real>
void Fluid<Real>::keep_in_reach() {
  const auto limit = static_cast<Real>(reach<Real>(density.radius()));
  const std::int64_t bad = first_where(particles.size(), options.threads, [&](std::int64_t i) {
    const Point<Real>& x = predicted_[i];
    return !(std::abs(x.x) <= limit && std::abs(x.y) <= limit && std::abs(x.z) <= limit);
  });
  if (bad >= 0) {
    throw NonFiniteError(
        "particle " + std::to_string(particles.id[bad]) +
            " leaves what positions can be numbered in; is the step too long, or a "
            "particle falling for ever? (bounds=, on_escape=\"remove\")",
        time, particles.id[bad]);
  }
}

// Brings the particles into the order of the cells of their predicted positions; lists neighbours.
template <class Real>
void Fluid<Real>::sort() {
  const auto h = static_cast<Real>(density.radius());
  neighbours_.sort(predicted_, h, options.threads);
  const std::int64_t n = particles.size();
  const auto rows = usize(n) + 1;
  next_.resize(n, false);
  next_.x.resize(rows);
  old_x_.resize(usize(n));
  old_v_.resize(usize(n));
  mass_.assign(options.masses.size() > 1 ? usize(n) : 1, static_cast<Real>(options.masses[0]));
  multipliers_.resize(rows);
  const std::span<const std::int32_t> order = neighbours_.order();
  parallel_for(
      n, kRows,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          const std::int32_t i = order[k];
          next_.x[k] = predicted_[i];
          old_x_[k] = particles.x[i];
          old_v_[k] = particles.v[i];
          next_.v[k] = {0, 0, 0, 0};
          if (mass_.size() > 1) mass_[k] = static_cast<Real>(mass(i));
          next_.id[k] = particles.id[i];
          next_.fluid[k] = particles.fluid[i];
        }
      },
      options.threads);
  next_.x[rows - 1] = density.far_point();
  multipliers_[rows - 1] = density.far_point();
  poll_interrupt();
  neighbours_.find(std::span<const Point<Real>>(next_.x).first(rows - 1), h, geometry::Pairs::kFull,
                   options.threads);
}

// Begins with a share of the multipliers that the last step added up to, as Ihmsen et al.
// ("Implicit incompressible SPH", 2014) do with pressures: what slowly changing pressure takes is
// then partly done. A share of all, not all that the sweeps did: then no step answers to the one
// before it, and the share left to the sweeps is the same in each.
template <class Real>
void Fluid<Real>::warm_start(double dt) {
  const std::span<Point<Real>> rows(next_.x), x = rows.first(rows.size() - 1);
  if (options.warm_start == 0 || last_dt == 0) return;
  const double ratio = dt / last_dt;  // lambda is as pressure times dt^2
  const auto scale = static_cast<Real>(options.warm_start * ratio * ratio);
  parallel_for(
      next_.size(), kRows,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          multipliers_[i] = {x[i].x, x[i].y, x[i].z, scale * old_v_[i].w};
        }
      },
      options.threads);
  const auto walls = boundary.contributions(x, options.threads);
  new_report_.limited +=
      density.correct(multipliers_, neighbours_, walls, rows, next_.v, options.threads);
  boundary.project(multipliers_, old_x_, x, mass_, options.threads);
}

// Sweeps until the density error is below its bounds or the iterations are used up.
template <class Real>
void Fluid<Real>::solve(double tolerance, double max_tolerance) {
  const std::span<Point<Real>> rows(next_.x), x = rows.first(rows.size() - 1);
  FluidReport& r = new_report_;
  density_rows_.resize(boundary.yields() ? x.size() : 0);
  for (r.converged = false; r.iterations < options.max_iterations; ++r.iterations) {
    poll_interrupt();
    const auto walls = boundary.contributions(x, options.threads);
    r.density_error =
        density.multipliers(rows, neighbours_, walls, multipliers_, options.threads, density_rows_);
    r.converged = r.density_error.mean <= tolerance && r.density_error.max <= max_tolerance;
    if (r.converged && r.iterations >= options.min_iterations) break;
    if (boundary.yields())
      boundary.share(x, density_rows_, options.density.one_sided, multipliers_);
    r.limited += density.correct(multipliers_, neighbours_, walls, rows, next_.v, options.threads);
    boundary.project(multipliers_, old_x_, x, mass_, options.threads);
  }
}

// Sets the density right; a share of what that moves becomes velocity. All of it is the damping of
// position-based fluids; with none, what lifts particles for nothing goes on to stir the liquid.
template <class Real>
void Fluid<Real>::correct(double dt) {
  constexpr double kShare = 0.075;
  predicted_.assign(next_.x.begin(), next_.x.end());
  boundary.set_share(kShare);
  solve(options.tolerance, options.max_tolerance);
  const auto rate = static_cast<Real>(kShare / dt);
  for_particles(
      next_.size(),
      [&](std::int64_t i) {
        const Point<Real>&x = next_.x[usize(i)], &before = predicted_[usize(i)];
        Point<Real>& v = next_.v[usize(i)];
        v = {v.x + rate * (x.x - before.x), v.y + rate * (x.y - before.y),
             v.z + rate * (x.z - before.z), v.w};
      },
      options.threads);
}

template <class Real>
typename Forces<Real>::Rows Fluid<Real>::rows() const {
  return {neighbours_,
          next_.fluid,
          static_cast<Real>(density.radius()),
          static_cast<Real>(density.volume()),
          options.density.dimension,
          options.threads};
}

template <class Real>
Point<Real> Fluid<Real>::gravity() const {
  const Vec3& g = options.gravity;
  return {static_cast<Real>(g.x()), static_cast<Real>(g.y()), static_cast<Real>(g.z()), 0};
}

// v += dt (g + f / m), and surface tension.
template <class Real>
void Fluid<Real>::accelerate(double dt) {
  const std::span<const std::int32_t> order = neighbours_.order();
  const double m0 = options.masses[0];
  const auto h = static_cast<Real>(dt);
  const Point<Real> g = gravity();
  boundary.accelerate_bodies(dt);
  for_particles(
      next_.size(),
      [&](std::int64_t k) {
        Point<Real>& v = next_.v[usize(k)];
        v.x += h * g.x, v.y += h * g.y, v.z += h * g.z;
        if (particles.f.empty()) return;
        const Point<Real>& f = particles.f[usize(order[usize(k)])];
        const Real w = h * next_.x[usize(k)].w / static_cast<Real>(m0);
        v.x += w * f.x, v.y += w * f.y, v.z += w * f.z;
      },
      options.threads);
  next_.v.push_back({0, 0, 0, 0});
  forces_.pull_together(options.forces, rows(), m0, dt, next_.x, next_.v);
  next_.v.pop_back();
}

// What bodies do by the multipliers that the projection begins with.
template <class Real>
void Fluid<Real>::add_response(std::span<const YieldingBody<Real>> bodies) {
  for (const YieldingBody<Real>& body : bodies) {
    const Vec6 gained = body.gained(std::span<const Real>(lambda_));
    for (const BodyRow& row : body.rows) {
      pushes_[usize(row.particle)].w += static_cast<Real>(row.q.dot(gained));
    }
  }
}

// A pressure takes from the velocities what would compress; obstacles get what it gives them.
template <class Real>
void Fluid<Real>::project(double dt) {
  constexpr double kSurface = 0.9;  // density
  const std::int64_t n = next_.size();
  const auto x = std::span<const Point<Real>>(next_.x).first(usize(n));
  const typename VelocityProjection<Real>::Walls walls{boundary.contributions(x, options.threads),
                                                       boundary.moments(x, options.threads)};
  next_.v.push_back({0, 0, 0, 0});
  const Neighbourhood<Real> near{next_.x,
                                 next_.v,
                                 neighbours_,
                                 static_cast<Real>(density.radius()),
                                 static_cast<Real>(density.volume()),
                                 options.density.dimension,
                                 options.threads};
  projection_.prepare(near, walls, kSurface, dt);
  // Walls push along their normal alone: what slides along one is not compressed.
  const auto push = [&](std::int64_t i, const Point<Real>& g) {
    const Vec3 along = xyz(projection_.correction(i).times(g)), out = xyz(g);
    return Vec3(along.dot(out) / out.squaredNorm() * out);
  };
  pushes_.assign(usize(n), {0, 0, 0, 0});
  boundary.for_near(
      x,
      [&](std::int64_t i, const Point<Real>& g, const Vec3& velocity, std::int32_t) {
        if (xyz(g).isZero(0)) return;
        const Vec3 along = push(i, g);
        Point<Real>& sum = pushes_[usize(i)];
        sum.x += static_cast<Real>(along.x());
        sum.y += static_cast<Real>(along.y());
        sum.z += static_cast<Real>(along.z());
        sum.w += static_cast<Real>(along.dot(velocity));
      },
      options.threads);
  lambda_.resize(usize(n) + 1);
  lambda_[usize(n)] = 0;
  const auto ratio = static_cast<Real>(last_dt > 0 ? dt / last_dt : 0);
  for (std::int64_t i = 0; i < n; ++i) lambda_[usize(i)] = ratio * old_v_[usize(i)].w;
  const auto bodies = boundary.rows_of_bodies(x, push);
  add_response(bodies);
  new_report_.projection =
      projection_.project(near, pushes_, bodies, dt, options.divergence_tolerance,
                          options.divergence_iterations, lambda_, next_.v);
  next_.v.pop_back();
  boundary.for_near(
      x,
      [&](std::int64_t i, const Point<Real>& g, const Vec3&, std::int32_t c) {
        const Real lambda = lambda_[usize(i)];
        if (c < 0 || lambda == 0 || xyz(g).isZero(0)) return;
        const Vec3 dv = -double(x[usize(i)].w) * double(lambda) * push(i, g);
        boundary.add_impulse(c, i, x[usize(i)], dv, dt, mass_[mass_.size() == 1 ? 0 : usize(i)]);
      },
      options.threads);
  refuse_bad_velocity([&](std::int64_t i) { return next_.v[usize(i)]; });
  boundary.slide(x, next_.v, mass_);
  boundary.end_step(old_x_, old_v_, now(), next_.v, mass_);
  for (std::int64_t i = 0; i < n; ++i) next_.v[usize(i)].w = lambda_[usize(i)];
}

template <class Real>
void Fluid<Real>::act_on_velocities(double dt) {
  if (!options.forces.any_on_velocities()) return;
  next_.v.push_back({0, 0, 0, 0});
  new_report_.viscosity = forces_.act_on_velocities(options.forces, rows(), next_.x, dt, next_.v);
  next_.v.pop_back();
  refuse_bad_velocity([&](std::int64_t i) { return next_.v[i]; });
}

// v = (x* - x) / dt.
template <class Real>
void Fluid<Real>::finish(double dt) {
  const auto rate = static_cast<Real>(1 / dt);
  refuse_bad_velocity([&](std::int64_t i) {
    const Point<Real>&x = next_.x[i], &old = old_x_[i];
    Point<Real>& v = next_.v[i];
    return v = {(x.x - old.x) * rate, (x.y - old.y) * rate, (x.z - old.z) * rate, v.w};
  });
  boundary.end_step(old_x_, old_v_, now(), next_.v, mass_);
}

template <class Real>
template <class Velocity>
void Fluid<Real>::refuse_bad_velocity(const Velocity& velocity) const {
  const std::int64_t bad = first_where(next_.size(), options.threads, [&](std::int64_t i) {
    const Point<Real> v = velocity(i);
    return !std::isfinite(v.x + v.y + v.z);
  });
  if (bad >= 0) {
    throw NonFiniteError("the velocity of particle " + std::to_string(next_.id[bad]) +
                             " is not finite; take a shorter step",
                         time, next_.id[bad]);
  }
}

template <class Real>
void Fluid<Real>::keep_in_bounds() {
  next_.x.resize(usize(next_.size()));
  if (!options.bounds) return;
  const auto& [low, high] = *options.bounds;
  std::vector<std::uint8_t> outside(usize(next_.size()));
  for (std::int64_t i = 0; i < next_.size(); ++i) {
    const Vec3 at = world(next_.x[i]), held = at.cwiseMax(low).cwiseMin(high);
    if (at == held) continue;
    if (options.on_escape == OnEscape::kRaise) {
      throw SolverError("particle " + std::to_string(next_.id[i]) + " leaves the bounds", time,
                        next_.id[i]);
    }
    outside[i] = 1;
    if (options.on_escape == OnEscape::kClamp) {
      next_.x[i] = local(held, next_.x[i].w);
      next_.v[i] = {0, 0, 0, 0};
      ++new_report_.clamped;
    } else {
      ++new_report_.removed;
    }
  }
  if (new_report_.removed > 0) next_.erase(outside);
}

// What came out of emitters since the last step, and goes into sinks.
template <class Real>
void Fluid<Real>::let_flow(double end) {
  new_counts_ = flow.counts;
  new_next_id_ = next_id;
  for (std::size_t k = 0; k < flow.emitters.size(); ++k) {
    const geometry::Emitted came = flow.emitters[k].let_out(new_counts_.layers[k], end);
    append(next_, new_next_id_, came.x, came.v, came.kinds);
    new_next_id_ += static_cast<std::int64_t>(came.x.size());
  }
  for (std::size_t k = 0; k < flow.sinks.size(); ++k) {
    new_counts_.absorbed[k] += absorb(next_, *flow.sinks[k]);
  }
}

template <class Real>
void Fluid<Real>::commit(double dt) noexcept {
  std::swap(particles, next_);
  std::swap(flow.counts, new_counts_);
  next_id = new_next_id_;
  report = new_report_;
  time += dt;
  last_dt = dt;
}

template <class Real>
double Fluid<Real>::fastest() const {
  // The largest g . x and v^2 - 2 g . x.
  struct Largest {
    double depth = -std::numeric_limits<double>::infinity(), energy = depth;
    void operator+=(const Largest& other) {
      depth = std::max(depth, other.depth);
      energy = std::max(energy, other.energy);
    }
  };
  const auto of = [&](std::int64_t i) {
    const double depth = options.gravity.dot(xyz(particles.x[i]));
    return Largest{depth, xyz(particles.v[i]).squaredNorm() - 2 * depth};
  };
  const auto [depth, energy] = ordered_sum(particles.size(), of, options.threads);
  return particles.size() == 0 ? 0 : std::sqrt(std::max(0.0, energy + 2 * depth));
}

template <class Real>
Energies Fluid<Real>::energies() const {
  const auto of = [&](std::int64_t i) {
    const Vec3 x = world(particles.x[i]), v = xyz(particles.v[i]);
    const double m = mass(i);
    return Energies{.kinetic = 0.5 * m * v.squaredNorm(),
                    .potential = -m * options.gravity.dot(x),
                    .momentum = m * v,
                    .angular_momentum = m * x.cross(v)};
  };
  return ordered_sum(particles.size(), of, options.threads);
}

template <class Real>
std::vector<Real> Fluid<Real>::densities() const {
  geometry::Neighbours<Real> neighbours(options.density.dimension);
  const auto h = static_cast<Real>(density.radius());
  neighbours.sort(particles.x, h, options.threads);
  const std::span<const std::int32_t> order = neighbours.order();
  std::vector<Point<Real>> x;
  x.reserve(order.size() + 1);
  for (const std::int32_t i : order) x.push_back(particles.x[i]);
  neighbours.find(x, h, geometry::Pairs::kFull, options.threads);
  Boundary<Real> walls = boundary;
  walls.place_layers(flow.counts.layers, time);
  walls.find_near(x, options.threads);
  std::vector<Real> sorted(order.size()), result(order.size());
  const auto contributions = walls.contributions(x, options.threads);
  x.push_back(density.far_point());
  density.densities(x, neighbours, contributions, sorted, options.threads);
  for (std::size_t k = 0; k < order.size(); ++k) result[order[k]] = sorted[k];
  return result;
}

template class Fluid<float>;
template class Fluid<double>;

}  // namespace substep::pbf
