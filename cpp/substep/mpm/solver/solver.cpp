// Steps in time. solver_step_size.cpp chooses how large they are; solver_particles.cpp,
// solver_edits.cpp and solver_state.cpp have what reads and writes particles.
#include "substep/mpm/solver/solver.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <new>
#include <optional>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/usize.h"
#include "substep/mpm/general/general.h"
#include "substep/mpm/particles/particle_loop.h"
#include "substep/mpm/solver/text.h"
#include "substep/transfer/scatter.h"

namespace substep::mpm {

namespace {

// Whether the user asked to stop: an exception that waits until particles are at rest.
std::exception_ptr asked_to_stop() {
  try {
    poll_interrupt();
  } catch (...) {
    return std::current_exception();
  }
  return nullptr;
}

}  // namespace

template <class Real, int D>
void Solver<Real, D>::step(double dt) {
  report_ = {};
  const double end = clock_.time + dt;
  if (!(end > clock_.time) || !std::isfinite(end)) {
    throw InputError(text("dt: expected a step above the spacing of the time, got %g s", dt));
  }
  const auto run_to_end = [&] { run({end, end}, dt, Steps::kAll); };
  if (options_.on_large_step == OnLargeStep::kRaise && !flow_.any()) return run_to_end();
  whole(run_to_end);  // several steps, or one and what flows after, that must all be done or none
}

template <class Real, int D>
void Solver<Real, D>::step_by_limit() {
  const double end = clock_.time + 3 * step_limit().dt;  // none of the last two, which are shorter
  report_ = {};
  goes_on_ = false;
  run({end, end}, 0, Steps::kOneAlone);
}

template <class Real, int D>
void Solver<Real, D>::advance(double end) {
  report_ = {};
  while (clock_.time < end) run(next_leg(end), options_.step, Steps::kAll);
}

template <class Real, int D>
Leg Solver<Real, D>::next_leg(double end) const {
  constexpr double kLooks = 4;  // steps after which sinks look again
  const double now = clock_.time;
  double until = std::min(end, flow_.next(now));
  if (!flow_.sinks.empty()) {
    const double look = now + kLooks * (options_.step > 0 ? options_.step : step_limit().dt);
    if (look > now) until = std::min(until, look);
  }
  return {now + (until - now), until};
}

template <class Real, int D>
void Solver<Real, D>::advance_once(const Leg& leg, bool goes_on) {
  report_ = {};
  goes_on_ &= goes_on;
  run(leg, options_.step, Steps::kNext);
}

// What must go on to its end, or back to here.
template <class Real, int D>
void Solver<Real, D>::keep_state() {
  if (kept_) return;
  kept_.emplace(particles_, grid_, clock_, report_, forces_, flow_.counts, near_bounds_);
}

template <class Real, int D>
void Solver<Real, D>::put_back() noexcept {
  if (!kept_) return;
  particles_ = std::move(kept_->particles);
  grid_ = std::move(kept_->grid);
  clock_ = kept_->clock;
  report_ = kept_->report;
  forces_ = std::move(kept_->forces);
  flow_.counts = std::move(kept_->counts);
  near_bounds_ = kept_->near_bounds;
  kept_.reset();
}

template <class Real, int D>
void Solver<Real, D>::run(const Leg& leg, double given, Steps steps) {
  flow_.check(leg.end);
  std::vector<geometry::Collider> colliders = grid_.colliders;
  const Report before = report_;
  const double start = clock_.time;
  const bool within = kept_.has_value();
  const auto taken = [&] { return report_.steps > before.steps; };
  const auto end_run = [&] {
    const bool one = report_.steps == before.steps + 1;
    const double duration = one ? report_.dt : clock_.time - start;
    for (geometry::Collider& collider : grid_.colliders) {
      if (taken()) collider.end_step(duration);
    }
  };
  grid_.clear_exchange();
  goes_on_ &= steps == Steps::kNext;
  if (!goes_on_) wave_age_ = kWaveSteps;
  try {
    while (clock_.time < leg.stop && !(steps != Steps::kAll && taken())) {
      steps_until_rest(leg, given, steps);
      const double reached = clock_.time;
      if (reached >= leg.stop) clock_.time = leg.end;
      if (flow_.any() && (reached >= leg.stop || steps == Steps::kOneAlone)) let_flow();
      if (!within) kept_.reset();
    }
    end_run();
  } catch (...) {
    put_back();
    if (!taken()) {
      grid_.colliders.swap(colliders);
      report_ = before;
    }
    end_run();
    throw;
  }
}

// p2g; grid; then g2p fused with the next p2g, grid; ...; g2p. What fails leaves the state after
// the last good step. A step that is taken alone goes back to where it began: in which particles
// may leave the bounds, or that something flows after.
template <class Real, int D>
void Solver<Real, D>::steps_until_rest(const Leg& leg, double given, Steps steps) {
  poll_interrupt();
  NextStep step = first_step(leg.stop, given);
  if (near_bounds_ || ends(leg, step, steps) || scheme().musl) keep_state();
  reserve_run(step, leg.stop);
  for (;;) {
    const std::exception_ptr stop = asked_to_stop();
    // From here to the next turn particles may be between two steps.
    const DeferInterrupts uninterrupted;
    const bool last = stop || steps != Steps::kAll;
    std::optional<NextStep> after = following(step, leg, given, last);
    if (!after) {
      rest(step);
      if (stop) std::rethrow_exception(stop);
      return;
    }
    const Trial trial = go_on(step, *after);
    if (trial.outcome != Outcome::kGood) return return_to_good_step();  // and tried from there
    step = std::move(*after);
  }
}

// The first step of a run, shortened until it is good. Nodes are those of it then.
template <class Real, int D>
typename Solver<Real, D>::NextStep Solver<Real, D>::first_step(double end, double given) {
  NextStep step = choose_first(end, given);
  shrinks_ = 0;
  // An implicit step is dear: it is not solved twice for want of room.
  if (options_.integrator == Integrator::kImplicit && clock_.drift > 0) sort_resting();
  Trial trial = begin_step(step.dt);
  if (goes_on_ && trial.outcome != Outcome::kGood) {
    goes_on_ = false;
    step = choose_first(end, given);
    trial = begin_step(step.dt);
  }
  for (; trial.outcome != Outcome::kGood; trial = begin_step(step.dt)) shrink(step, trial, given);
  if (!fast() && clock_.drift + trial.nodes.reach > room()) {
    sort_resting();
    trial = begin_step(step.dt);
  }
  step.speed = trial.nodes.speed;
  step.reach = trial.nodes.reach;
  return step;
}

template <class Real, int D>
typename Solver<Real, D>::NextStep Solver<Real, D>::choose_first(double end, double given) {
  if (goes_on_) {
    NextStep step = choose(clock_.time, end, given, next_limit_);
    if (step.refused.empty()) return step;
    goes_on_ = false;
  }
  const double speed = largest_speed(particles_, options_.threads);
  NextStep step = choose(clock_.time, end, given, limit_now(speed, given));
  if (!step.refused.empty()) raise(step.refused, limiting(step.limit));
  return step;
}

// What memory a run needs is there before it begins.
template <class Real, int D>
void Solver<Real, D>::reserve_run(const NextStep& step, double end) {
  good_.clear();
  begin_.clear();
  if (!fast() || !(step.end < end)) return;
  next_.values.reset(nodes_.values.size());
  base_.values.reset(nodes_.values.size());
}

// The step that is to be fused with a good one; none where particles come to rest between them.
template <class Real, int D>
std::optional<typename Solver<Real, D>::NextStep> Solver<Real, D>::following(const NextStep& step,
                                                                             const Leg& leg,
                                                                             double given,
                                                                             bool stop) {
  return or_recover(step, [&]() -> std::optional<NextStep> {
    make_room(step);
    goes_on_ = !near_bounds_ && fast() && step.end < leg.stop;
    if (!goes_on_) return {};
    next_limit_ = limit_now(step.speed, given);
    if (stop) return {};
    const std::int64_t subdivided = report_.subdivided;
    NextStep after = choose(step.end, leg.stop, given, next_limit_);
    goes_on_ = after.refused.empty();
    if (!goes_on_) return {};
    if (!kept_ && ends(leg, after, Steps::kAll)) {  // it is taken alone
      report_.subdivided = subdivided;
      return {};
    }
    if (begin_.empty()) begin_.push_back({grid_, clock_, report_});
    good_.push_back(step);
    return after;
  });
}

// Takes a good step and tries the next one.
template <class Real, int D>
typename Solver<Real, D>::Trial Solver<Real, D>::go_on(const NextStep& step, NextStep& after) {
  g2p2g(particles_, step.dt, after.dt, nodes_, next_, options_.threads);
  commit(step);
  if (good_.size() == 1) base_.values.swap(nodes_.values);
  nodes_.values.swap(next_.values);
  const Trial trial = or_recover(after, [&] { return update(after.dt); });
  after.speed = trial.nodes.speed;
  after.reach = trial.nodes.reach;
  return trial;
}

// From rest. Particles do not change.
template <class Real, int D>
typename Solver<Real, D>::Trial Solver<Real, D>::begin_step(double dt) {
  const bool implicit = options_.integrator == Integrator::kImplicit;
  if (fast()) {
    carry_velocities(particles_, options_.threads);
    p2g(particles_, dt, nodes_, options_.threads);
  } else {
    p2g(scheme(), particles_, implicit ? 0 : dt, nodes_, before_, options_.threads);
  }
  work_ = forces_.empty() ? 0 : push(dt);
  return implicit ? solve(dt) : update(dt);
}

// The momentum at the end of an implicit step, gravity and obstacles included.
template <class Real, int D>
typename Solver<Real, D>::Trial Solver<Real, D>::solve(double dt) {
  const std::span<Real> nodes = {nodes_.values.data(), nodes_.values.size()};
  try {
    implicit_.solve(particles_, nodes, dt, options_.gravity, options_.order, options_.form,
                    grid_.colliders, options_.boundaries, options_.threads);
  } catch (const NonFiniteError& error) {
    // Stress that is none shows at nodes in an explicit step, and there whose it is.
    p2g(scheme(), particles_, dt, nodes_, before_, options_.threads);
    const NodeCheck check = grid_.update(nodes, options_.gravity, dt, HUGE_VAL, options_.threads);
    if (!check.good()) raise_not_finite(check.bad_node);
    throw NonFiniteError(error.what(), clock_.time, -1, report_.steps);
  }
  if (!implicit_.report().converged) return {Outcome::kNotConverged, {}};
  return judged(
      grid_.update(nodes, Vec3::Zero(), dt, room() * options_.cell / dt, options_.threads));
}

template <class Real, int D>
typename Solver<Real, D>::Trial Solver<Real, D>::update(double dt) {
  ++wave_age_;
  const bool by_particles = !fast() && uses_gradients(scheme());
  const double bound =
      by_particles ? std::numeric_limits<Real>::max() : room() * options_.cell / dt;
  NodeCheck check = grid_.update({nodes_.values.data(), nodes_.values.size()}, options_.gravity, dt,
                                 bound, options_.threads);
  if (by_particles && check.good()) {
    const double push = check.reach - check.speed * dt / options_.cell;
    check.speed = greatest_speed(scheme(), particles_, nodes_, options_.threads);
    check.reach = check.speed * dt / options_.cell + push;
    grid_.particles().set_reach(check.reach);
  }
  return judged(check);
}

template <class Real, int D>
typename Solver<Real, D>::Trial Solver<Real, D>::judged(const NodeCheck& nodes) const {
  if (!nodes.good()) return {Outcome::kBadNode, nodes};
  return {nodes.reach <= room() ? Outcome::kGood : Outcome::kTooFar, nodes};
}

template <class Real, int D>
Scheme Solver<Real, D>::scheme() const {
  const bool is_explicit = options_.integrator == Integrator::kExplicit;
  return {options_.order,
          options_.transfer,
          options_.form,
          options_.flip_rate,
          options_.order == 1 && is_explicit,
          is_explicit};
}

template <class Real, int D>
void Solver<Real, D>::end_step(double dt) {
  if (fast()) {
    g2p(particles_, dt, nodes_, options_.threads);
  } else if (scheme().musl) {
    remap(scheme(), particles_, dt, nodes_, before_, next_, options_.threads);
    grid_.hold({next_.values.data(), next_.values.size()}, options_.threads);
    g2p(scheme(), particles_, dt, next_, before_, options_.threads);
  } else {
    g2p(scheme(), particles_, dt, nodes_, before_, options_.threads);
  }
}

template <class Real, int D>
void Solver<Real, D>::sort_resting() {
  keep_state();
  sort_at_rest(particles_, options_.threads);
  clock_.drift = 0;
  ++report_.sorts;
  layout_changed();
}

// Sorts where particles could leave the arenas of their blocks.
template <class Real, int D>
void Solver<Real, D>::make_room(const NextStep& step) {
  if (!fast() || clock_.drift + step.reach <= room()) return;
  std::optional<ParticleBoundary<Real, D>> walls;
  sort<Real, D>(particles_, nodes_, options_.threads, [&](const transfer::BlockLayout<D>& layout) {
    walls.emplace(grid_.walls_of(layout, options_.threads));
  });
  clock_.drift = 0;
  ++report_.sorts;
  good_.clear();
  begin_.clear();
  set_layout(std::move(*walls));
  next_.values.reset(nodes_.values.size());
  base_.values.reset(nodes_.values.size());
}

// Where particles are near the bounds only since this step, when they were sorted, none leaves
// them.
template <class Real, int D>
void Solver<Real, D>::rest(const NextStep& step) {
  end_step(step.dt);
  const std::int32_t escaped = near_bounds_ && kept_ ? first_escaped() : -1;
  if (escaped >= 0 && options_.on_escape == OnEscape::kRaise) {
    raise("particle " + std::to_string(escaped) +
              " leaves the bounds (on_escape=\"remove\" or \"clamp\" would go on)",
          escaped);
  }
  commit(step);
  if (escaped >= 0) hold_escaped();
}

// What a step that was taken leaves behind, particles aside. Needs no memory, as they have moved.
template <class Real, int D>
void Solver<Real, D>::commit(const NextStep& step) noexcept {
  std::vector<geometry::Collider>& colliders = grid_.colliders;
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    given_[c] = colliders[c].exchange();
    colliders[c].set_exchange({});
  }
  clock_.drift += step.reach + grid_.finish();
  const bool implicit = options_.integrator == Integrator::kImplicit;
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    geometry::Exchange now = colliders[c].exchange();
    if (implicit) now += implicit_.exchanges()[c];
    clock_.supply(
        -(now.impulse.dot(colliders[c].velocity) + now.torque.dot(colliders[c].angular_velocity)));
    given_[c] += now;
    colliders[c].set_exchange(given_[c]);
  }
  if (implicit) {
    report_.newton += implicit_.report().newton;
    report_.krylov += implicit_.report().krylov;
  }
  clock_.supply(work_);
  work_ = 0;
  forces_.clear();
  clock_.time = step.end;
  ++report_.steps;
  report_.dt = step.dt;
  report_.limit = step.limit;
}

// The step after the last of `good_` has failed.
template <class Real, int D>
void Solver<Real, D>::return_to_good_step() {
  goes_on_ = false;
  rewind(particles_, options_.threads);
  grid_ = std::move(begin_[0].grid);
  clock_ = begin_[0].clock;
  report_ = begin_[0].report;
  nodes_.values.swap(base_.values);
  for (std::size_t k = 0; k + 1 < good_.size(); ++k) {
    g2p2g(particles_, good_[k].dt, good_[k + 1].dt, nodes_, next_, options_.threads);
    commit(good_[k]);
    nodes_.values.swap(next_.values);
    update(good_[k + 1].dt);
  }
  g2p(particles_, good_.back().dt, nodes_, options_.threads);
  commit(good_.back());
}

// Does what needs memory while particles are between two steps. Where there is none, the way to a
// state after a whole step needs none that was not there before: back to what was kept or to the
// last good one or, with none to go back to, on through `step`.
template <class Real, int D>
template <class Work>
auto Solver<Real, D>::or_recover(const NextStep& step, const Work& work) {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    if (kept_) throw;
    if (!good_.empty()) {
      return_to_good_step();
    } else if (!particles_.motion) {  // sorted: the way back is lost, the step itself is good
      end_step(step.dt);
      commit(step);
    }
    throw;
  }
}

// Adds the momentum of the forces on the particles to the nodes; returns their work [J].
template <class Real, int D>
double Solver<Real, D>::push(double dt) {
  const Places places = places_of_ids();
  double work = 0;
  for (std::size_t b = 0; b < particles_.layout.particle_keys.size(); ++b) {
    for_packets_of_block(
        particles_, static_cast<std::int32_t>(b),
        [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
          for (int lane = 0; lane < count; ++lane) {
            const Slot s{g, p, lane, block};
            const Vec3 f = forces_[usize(places[id_of(particles_, s)])];
            if (f.isZero(0)) continue;
            const double m =
                density(options_.materials[g]) *
                static_cast<double>(particles_.groups[g].volume[s.template id_index<Real>()]);
            work += dt * f.dot(velocity_of(particles_, s) + dt / (2 * m) * f);
            std::array<double, D> x, along;
            for (int d = 0; d < D; ++d) {
              x[usize(d)] = static_cast<double>(state_of(particles_, s, d));
              along[usize(d)] = f[d];
            }
            transfer::scatter<Real, D>(options_.order, x, along, dt, particles_.layout.arenas[b],
                                       nodes_);
          }
        });
  }
  return work;
}

template class Solver<float, 2>;
template class Solver<float, 3>;
template class Solver<double, 2>;
template class Solver<double, 3>;

}  // namespace substep::mpm
