// What is in a liquid: particles that are put in, come and go, and what is told of them.
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/liquid/grid_liquid.h"

namespace substep::gridfluid {
namespace {

constexpr std::int64_t kOfTask = 4096;  // particles that a task works on

template <int D>
Layout<D> layout_of(const LiquidOptions& options) {
  std::array<int, D> cells;
  std::array<bool, D> periodic;
  for (std::size_t a = 0; a < D; ++a)
    cells[a] = options.cells[a], periodic[a] = options.periodic[a];
  return Layout<D>(cells, periodic);
}

template <int D>
OpenSides<D> open_sides(const LiquidOptions& options) {
  OpenSides<D> open;
  for (std::size_t a = 0; a < D; ++a) open[a] = options.open[a];
  return open;
}

}  // namespace

template <class Real, int D>
GridLiquid<Real, D>::GridLiquid(std::vector<geometry::Collider> colliders,
                                const LiquidOptions& options_, geometry::ParticleFlow flow_)
    : options(options_),
      layout(layout_of<D>(options)),
      obstacles(layout, options.low, options.cell, std::move(colliders), options.viscosity > 0),
      particles(options.transfer == Transfer::kApic),
      flow(std::move(flow_)),
      next_(options.transfer == Transfer::kApic),
      projection_(layout, open_sides<D>(options)),
      viscosity_(layout, open_sides<D>(options), options.slip) {
  for (Fields* fields : {&u_, &old_u_, &shift_, &weight_}) {
    for (Field& field : *fields) assign(field, layout.size, Real(0));
  }
  assign(phi_, layout.size, Real(0));
  assign(density_, layout.size, Real(0));
  assign(q, layout.size, 0.0);
  if (options.narrow_band > 0) band.emplace(layout, open_sides<D>(options));
}

template <class Real, int D>
void GridLiquid<Real, D>::keep() {
  Particles<Real, D> room(particles.affine());
  if (kept_) std::swap(room, kept_->particles);
  kept_.emplace(Kept{.particles = std::move(room),
                     .forces = forces,
                     .counts = flow.counts,
                     .report = report,
                     .time = time,
                     .last_dt = last_dt,
                     .next_id = next_id,
                     .q = q,
                     .band = band});
}

template <class Real, int D>
void GridLiquid<Real, D>::rewind() {
  if (!kept_) return;
  if (kept_->stepped) std::swap(particles, kept_->particles);
  forces.swap(kept_->forces);
  std::swap(flow.counts, kept_->counts);
  report = kept_->report;
  time = kept_->time;
  last_dt = kept_->last_dt;
  next_id = kept_->next_id;
  q.swap(kept_->q);
  std::swap(band, kept_->band);
  kept_.reset();
}

template <class Real, int D>
bool GridLiquid<Real, D>::is_inside(const Vec3& x) const {
  for (int a = 0; a < D; ++a) {
    const auto at = static_cast<Real>((x[a] - options.low[a]) / options.cell);
    if (!(at >= 0 && at <= static_cast<Real>(layout.cells[usize(a)]))) return false;
  }
  return true;
}

template <class Real, int D>
void GridLiquid<Real, D>::check_inside(std::span<const Vec3> x) const {
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (!is_inside(x[i])) {
      throw InputError("positions[" + std::to_string(i) + "]: expected a point in the box");
    }
  }
}

template <class Real, int D>
std::int64_t GridLiquid<Real, D>::add(std::span<const Vec3> x, std::span<const Vec3> v) {
  check_inside(x);
  append(particles, next_id, x, v);
  if (!forces.empty()) forces.resize(usize(particles.size()));
  return std::exchange(next_id, next_id + static_cast<std::int64_t>(x.size()));
}

template <class Real, int D>
void GridLiquid<Real, D>::append(Particles<Real, D>& to, std::int64_t first_id,
                                 std::span<const Vec3> x, std::span<const Vec3> v) const {
  std::vector<Real> at, velocities;
  std::vector<std::int64_t> ids;
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (int a = 0; a < D; ++a) {
      at.push_back(static_cast<Real>((x[i][a] - options.low[a]) / options.cell));
      velocities.push_back(static_cast<Real>(v[i][a]));
    }
    ids.push_back(first_id + static_cast<std::int64_t>(i));
  }
  to.append(static_cast<std::int64_t>(x.size()), at.data(), velocities.data(), nullptr, ids.data());
}

// What came out of emitters since the last step, but for what would be beyond the box, and goes by
// open sides and into sinks.
template <class Real, int D>
void GridLiquid<Real, D>::let_flow(double end) {
  new_counts_ = flow.counts;
  new_report_.removed = leave_by_open_sides();
  for (std::size_t k = 0; k < flow.emitters.size(); ++k) {
    geometry::Emitted came = flow.emitters[k].let_out(new_counts_.layers[k], end);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < came.x.size(); ++i) {
      if (!is_inside(came.x[i])) continue;
      came.x[kept] = came.x[i];
      came.v[kept++] = came.v[i];
    }
    came.x.resize(kept);
    came.v.resize(kept);
    append(next_, new_next_id_, came.x, came.v);
    new_next_id_ += static_cast<std::int64_t>(kept);
  }
  for (std::size_t k = 0; k < flow.sinks.size(); ++k) {
    new_counts_.absorbed[k] += absorb(*flow.sinks[k]);
  }
}

// Drops flagged particles; returns how many.
template <class Real, int D>
std::int64_t GridLiquid<Real, D>::drop(const std::vector<std::uint8_t>& flags) {
  const std::int64_t n = next_.size();
  if (std::find(flags.begin(), flags.end(), 1) != flags.end()) next_.erase(flags, options.threads);
  return n - next_.size();
}

template <class Real, int D>
std::int64_t GridLiquid<Real, D>::leave_by_open_sides() {
  std::vector<std::uint8_t> gone;
  for (int a = 0; a < D; ++a) {
    const auto& open = options.open[usize(a)];
    if (!open[0] && !open[1]) continue;
    gone.resize(usize(next_.size()));
    // They are kept in the box by a margin.
    const double low = 2 * kMargin, high = layout.cells[usize(a)] - 2 * kMargin;
    for (std::int64_t i = 0; i < next_.size(); ++i) {
      const auto x = double(next_.x(a)[i]);
      if ((open[0] && x <= low) || (open[1] && x >= high)) gone[usize(i)] = 1;
    }
  }
  return drop(gone);
}

template <class Real, int D>
std::int64_t GridLiquid<Real, D>::absorb(const geometry::Collider& region) {
  std::vector<std::uint8_t> inside(usize(next_.size()));
  parallel_for(
      next_.size(), kOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          inside[usize(i)] = region.signed_distance(position(next_, i)).value < 0 ? 1 : 0;
        }
      },
      options.threads);
  return drop(inside);
}

template <class Real, int D>
double GridLiquid<Real, D>::mass() const {
  return cell_mass() / (1 << D);
}

template <class Real, int D>
double GridLiquid<Real, D>::cell_mass() const {
  return options.density * std::pow(options.cell, D);
}

template <class Real, int D>
Vec3 GridLiquid<Real, D>::middle(std::int64_t i) const {
  const std::array<int, D> cell = layout.cell(i);
  Vec3 x = options.low;
  for (std::size_t a = 0; a < D; ++a) x[int(a)] += options.cell * (cell[a] + 0.5);
  return x;
}

// The cell of a point in the box.
template <class Real, int D>
std::int64_t GridLiquid<Real, D>::cell_at(const Vec3& x) const {
  std::array<int, D> cell;
  for (std::size_t a = 0; a < D; ++a) {
    const double at = (x[int(a)] - options.low[int(a)]) / options.cell;
    cell[a] = std::clamp(static_cast<int>(at), 0, layout.cells[a] - 1);
  }
  return layout.index(cell);
}

template <class Real, int D>
Vec3 GridLiquid<Real, D>::position(const Particles<Real, D>& of, std::int64_t row) const {
  Vec3 x = options.low;
  for (int a = 0; a < D; ++a) x[a] += options.cell * double(of.x(a)[row]);
  return x;
}

template <class Real, int D>
Vec3 GridLiquid<Real, D>::position(std::int64_t row) const {
  return position(particles, row);
}

template <class Real, int D>
Vec3 GridLiquid<Real, D>::velocity(std::int64_t row) const {
  Vec3 v = Vec3::Zero();
  for (int a = 0; a < D; ++a) v[a] = double(particles.v(a)[row]);
  return v;
}

template <class Real, int D>
void GridLiquid<Real, D>::set_position(std::int64_t row, const Vec3& x) {
  for (int a = 0; a < D; ++a) {
    particles.x(a)[row] = static_cast<Real>((x[a] - options.low[a]) / options.cell);
  }
}

template <class Real, int D>
void GridLiquid<Real, D>::set_velocity(std::int64_t row, const Vec3& v) {
  for (int a = 0; a < D; ++a) {
    particles.v(a)[row] = static_cast<Real>(v[a]);
    for (int b = 0; b < D && particles.affine(); ++b) particles.C(a, b)[row] = 0;
  }
}

template <class Real, int D>
void GridLiquid<Real, D>::remove(std::span<const std::uint8_t> flags) {
  next_ = particles;
  next_.erase(flags, options.threads);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < forces.size(); ++i) {
    if (flags[i] == 0) forces[kept++] = forces[i];
  }
  forces.resize(kept);
  std::swap(particles, next_);
}

template <class Real, int D>
double GridLiquid<Real, D>::fastest() const {
  std::vector<Real> parts(usize((particles.size() + kOfTask - 1) / kOfTask));
  parallel_for(
      particles.size(), kOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        Real most = 0;
        for (int a = 0; a < D; ++a) {
          const Real* const v = particles.v(a);
          for (std::int64_t i = begin; i < end; ++i) most = std::max(most, std::abs(v[i]));
        }
        parts[usize(begin / kOfTask)] = most;
      },
      options.threads);
  Real most = 0;
  for (const Real part : parts) most = std::max(most, part);
  if (!band) return double(most);
  for (const Field& u : band->velocity()) {
    for (const Real x : u) most = std::max(most, std::abs(x));
  }
  return double(most);
}

template <class Real, int D>
LiquidEnergies GridLiquid<Real, D>::energies() const {
  const std::int64_t n = particles.size();
  std::vector<LiquidEnergies> parts(usize((n + kOfTask - 1) / kOfTask));
  const double m = mass();
  parallel_for(
      n, kOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        LiquidEnergies part;
        for (std::int64_t i = begin; i < end; ++i) {
          const Vec3 x = position(i), v = velocity(i);
          part += {.kinetic = 0.5 * m * v.squaredNorm(),
                   .potential = -m * options.gravity.dot(x),
                   .momentum = m * v,
                   .angular_momentum = m * x.cross(v)};
        }
        parts[usize(begin / kOfTask)] = part;
      },
      options.threads);
  LiquidEnergies sum;
  for (const LiquidEnergies& part : parts) sum += part;
  if (band) sum += energies_of_deep();
  return sum;
}

template <class Real, int D>
std::vector<double> GridLiquid<Real, D>::pressure() const {
  const double most = std::numeric_limits<double>::max();
  std::vector<double> out;
  layout.for_cells([&](std::int64_t i) {
    const double p = q[usize(i)] * options.density * options.cell;
    out.push_back(p == 0 ? 0 : std::clamp(p / last_dt, -most, most));
  });
  return out;
}

template <class Real, int D>
std::vector<double> GridLiquid<Real, D>::level_set() {
  sort(0);
  find_surface();
  std::vector<double> out;
  layout.for_cells([&](std::int64_t i) { out.push_back(options.cell * double(phi_[usize(i)])); });
  return out;
}

template <class Real, int D>
std::vector<double> GridLiquid<Real, D>::grid_velocity() {
  sort(0);
  find_surface();
  projection_.set_domain(obstacles, {phi_.data(), phi_.size()}, options.threads);
  pass_to_grid();
  const std::span<const Cell> cells = projection_.cells();
  std::vector<double> out;
  layout.for_cells([&](std::int64_t i) {
    for (std::size_t a = 0; a < D; ++a) {
      const bool wet = cells[usize(i)] == Cell::kFluid;
      const double sum = double(u_[a][usize(i)]) + double(u_[a][usize(i + layout.stride[a])]);
      out.push_back(wet ? sum / 2 : 0);
    }
  });
  for (const double u : out) {
    if (!std::isfinite(u)) throw NonFiniteError("the sum of velocities in a cell overflows", time);
  }
  return out;
}

template class GridLiquid<float, 2>;
template class GridLiquid<float, 3>;
template class GridLiquid<double, 2>;
template class GridLiquid<double, 3>;

}  // namespace substep::gridfluid
