// How large a Solver's steps are, and which particle is at fault where none is small enough.
#include <algorithm>
#include <cmath>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/mpm/particles/particle_loop.h"
#include "substep/mpm/solver/solver.h"
#include "substep/mpm/solver/text.h"

namespace substep::mpm {
namespace {

constexpr int kShrinks = 20;    // times that a step is halved
constexpr double kSame = 1e-9;  // relative: steps that differ by less are the same

}  // namespace

template <class Real, int D>
StepLimit Solver<Real, D>::step_limit() const {
  return limit(largest_speed(particles_, options_.threads),
               wave_speed_squared(particles_, options_.threads));
}

// The limits of a step from a state whose wave speed is looked at now and then.
template <class Real, int D>
StepLimit Solver<Real, D>::limit_now(double speed, double given) {
  if (wave_age_ >= kWaveSteps && options_.integrator == Integrator::kExplicit) {
    wave_ = wave_speed_squared(particles_, options_.threads);
    wave_age_ = 0;
    if (!std::isfinite(wave_)) wave_ = 0;  // the step itself tells which particle is spoiled
  }
  StepLimit now = limit(speed, wave_);
  if (given > 0 && now.dt == options_.largest) now.dt = HUGE_VAL;  // that is for chosen steps
  return now;
}

template <class Real, int D>
StepLimit Solver<Real, D>::limit(double speed, double wave) const {
  const double dx = options_.cell, cfl = options_.cfl;
  StepLimit limit{options_.largest, "nothing moves"};
  const auto lower = [&](double dt, const char* reason) {
    if (dt < limit.dt) limit = {dt, reason};
  };
  if (options_.integrator == Integrator::kExplicit) {
    if (wave > 0) lower(cfl * dx / std::sqrt(wave), "elastic wave");
    for (std::size_t m = 0; m < options_.materials.size(); ++m) {
      if (particles_.groups[m].count == 0) continue;
      const double nu =
          std::visit([](const auto& a) { return a.kinematic_viscosity(); }, options_.materials[m]);
      if (nu > 0) lower(cfl * dx * dx / (2 * D * nu), "viscosity");
    }
  }
  if (speed > 0) lower(cfl * dx / speed, "particle speed");
  return limit;
}

// The last two steps before the end are equal: a very short one would be a waste.
template <class Real, int D>
typename Solver<Real, D>::NextStep Solver<Real, D>::choose(double now, double end, double given,
                                                           const StepLimit& limit) {
  double h = given > 0 ? given : limit.dt;
  NextStep step;
  step.limit = given > 0 ? "given" : limit.reason;
  if (given > limit.dt * (1 + kSame)) {
    if (options_.on_large_step == OnLargeStep::kRaise) {
      step.refused =
          text("a step of %.4g s is too large: %.4g s is the limit of the ", given, limit.dt) +
          limit.reason + " (on_large_step=\"subdivide\" would take shorter ones)";
    }
    h = limit.dt;
    step.limit = limit.reason;
    ++report_.subdivided;
  }
  const double left = end - now;
  if (left <= h * (1 + kSame)) {
    if (left < h * (1 - kSame)) step.limit = "end";
    step.dt = left < h * (1 - kSame) ? left : h;
    step.end = end;
    return step;
  }
  step.dt = left < 2 * h * (1 - kSame) ? left / 2 : h;
  step.end = now + step.dt;
  if (!(step.end > now && end + step.dt > end) && step.refused.empty()) {
    step.refused = text("a step of %.3g s, the limit of the ", step.dt) + step.limit +
                   text(
                       ", is below the spacing of times up to %.6g s: speeds or stiffness have "
                       "grown without bound; start again with shorter steps (cfl=, step=)",
                       end);
  }
  return step;
}

// A shorter step in place of one in which particles would move too far.
template <class Real, int D>
void Solver<Real, D>::shrink(NextStep& step, const Trial& trial, double given) {
  if (trial.outcome == Outcome::kNotConverged) return shrink_implicit(step, given);
  const NodeCheck& check = trial.nodes;
  double speed = check.speed;
  if (trial.outcome == Outcome::kBadNode) {
    const Real* v = nodes_.values.data() + check.bad_node * transfer::kNodeReals;
    for (int d = 0; d < D; ++d) speed = std::max(speed, std::abs(static_cast<double>(v[d])));
    for (int d = 0; d < D; ++d) {
      if (!std::isfinite(v[d])) raise_not_finite(check.bad_node);
    }
  }
  const std::int32_t id = trial.outcome == Outcome::kBadNode ? culprit(check.bad_node) : -1;
  const std::string moves = text("at %.3g m/s material would move by %.3g cells in the next step",
                                 speed, speed * step.dt / options_.cell);
  if (given > 0 && options_.on_large_step == OnLargeStep::kRaise) {
    raise(moves + "; take a shorter one, or on_large_step=\"subdivide\"", id);
  }
  if (++shrinks_ > kShrinks || !(clock_.time + step.dt / 2 > clock_.time)) {
    raise(moves + ", however short it is: speeds grow without bound", id);
  }
  halve(step, "particle speed");
}

// A shorter implicit step in place of one that did not converge.
template <class Real, int D>
void Solver<Real, D>::shrink_implicit(NextStep& step, double given) {
  const bool raises = given > 0 && options_.on_large_step == OnLargeStep::kRaise;
  if (raises || ++shrinks_ > kShrinks || !(clock_.time + step.dt / 2 > clock_.time)) {
    ConvergenceError error(
        text("the implicit step of %.4g s did not converge; ", step.dt) + implicit_.report().remedy,
        clock_.time, -1, report_.steps);
    error.residuals = implicit_.report().residuals;
    throw error;
  }
  halve(step, "convergence");
}

template <class Real, int D>
void Solver<Real, D>::halve(NextStep& step, const char* reason) {
  step.dt /= 2;
  step.end = clock_.time + step.dt;
  step.limit = reason;
  ++report_.subdivided;
}

// The id of the particle at rest that most likely spoiled a node: of those that reach it, one with
// a stress that is none, else the fastest one.
template <class Real, int D>
std::int32_t Solver<Real, D>::culprit(std::int64_t node) const {
  constexpr std::int64_t kNodes = transfer::NodeBlocks<Real, D>::kNodes;
  const auto block =
      transfer::BlockKey<D>::unpack(particles_.layout.node_keys[usize(node / kNodes)]);
  Vec3 at = Vec3::Zero();
  for (std::int64_t d = D - 1, rest = node % kNodes; d >= 0; --d, rest /= transfer::kBlock) {
    at[d] = options_.cell * (static_cast<double>(transfer::kBlock) * block[usize(d)] +
                             static_cast<double>(rest % transfer::kBlock));
  }
  const double reach = 0.5 * (options_.order + 1) * options_.cell;
  return id_of_greatest(
      particles_, [&](std::size_t g, std::int64_t p, std::int32_t in, int count, double* scores) {
        alignas(64) Real tau[6 * kLanes<Real>];
        packet_stress_at_rest(particles_, g, p, tau);
        for (int lane = 0; lane < count; ++lane) {
          const Slot s{g, p, lane, in};
          const bool near = (position_of(particles_, s) - at).cwiseAbs().maxCoeff() <= reach;
          scores[lane] = near ? velocity_of(particles_, s).norm() : -1;
          for (int k = 0; near && k < (D == 3 ? 6 : 4); ++k) {
            if (!std::isfinite(tau[k * kLanes<Real> + lane])) scores[lane] = HUGE_VAL;
          }
        }
      });
}

// The id of the particle at rest from which a step's limit comes, or -1.
template <class Real, int D>
std::int32_t Solver<Real, D>::limiting(const std::string& limit) const {
  const bool by_wave = limit == "elastic wave";
  if (!by_wave && limit != "particle speed") return -1;
  return id_of_greatest(
      particles_, [&](std::size_t g, std::int64_t p, std::int32_t in, int count, double* scores) {
        if (by_wave) return packet_wave_speeds(particles_, g, p, scores);
        for (int lane = 0; lane < count; ++lane) {
          scores[lane] = velocity_of(particles_, Slot{g, p, lane, in}).cwiseAbs().maxCoeff();
        }
      });
}

template <class Real, int D>
void Solver<Real, D>::raise_not_finite(std::int64_t node) const {
  const std::int32_t id = culprit(node);
  throw NonFiniteError(
      "the velocity of particle " + std::to_string(id) +
          " is not finite after the next step: its deformation is inverted or too large; "
          "start again with shorter steps (cfl=, step=)",
      clock_.time, id, report_.steps);
}

template <class Real, int D>
void Solver<Real, D>::raise(const std::string& message, std::int32_t id) const {
  throw SolverError(message, clock_.time, id, report_.steps);
}

template class Solver<float, 2>;
template class Solver<float, 3>;
template class Solver<double, 2>;
template class Solver<double, 3>;

}  // namespace substep::mpm
