#include "substep/springs/deformable.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"

namespace substep::springs {
namespace {

// Of the gradient that newly lagged friction brings: what is left of it before friction is lagged
// again.
constexpr double kLaggedGoal = 0.1;

// Steps of explicit integrators whose squared accelerations are so many times the largest of late,
// which is forgotten by a fiftieth in each step, may diverge.
constexpr double kSuspiciousGrowth = 1.1, kForgotten = 0.98;

// y + h k, vertex by vertex.
std::vector<Vec3> moved(Positions y, double h, Positions k) {
  std::vector<Vec3> sum(y.size());
  for (std::size_t i = 0; i < y.size(); ++i) sum[i] = y[i] + h * k[i];
  return sum;
}

void move(std::vector<Vec3>& y, double h, Positions k) {
  for (std::size_t i = 0; i < y.size(); ++i) y[i] += h * k[i];
}

void add_exchanges(std::vector<geometry::Exchange>& sums, const Contacts& contacts) {
  for (std::size_t c = 0; c < sums.size(); ++c) sums[c] += contacts.colliders[c].exchange();
}

}  // namespace

Deformable::Deformable(Positions x, Positions v, std::span<const double> masses,
                       std::span<const std::uint8_t> pinned,
                       std::vector<std::shared_ptr<Term>> terms, Contacts contacts_,
                       std::unique_ptr<Minimiser> minimiser, const DeformableOptions& options_)
    : positions(x.begin(), x.end()),
      velocities(v.begin(), v.end()),
      forces(x.size(), Vec3::Zero()),
      targets(x.begin(), x.end()),
      contacts(std::move(contacts_)),
      options(options_),
      minimiser_(std::move(minimiser)),
      pin_velocities_(x.size(), Vec3::Zero()) {
  contacts.stiffness.assign(x.size(), 0.0);
  std::unique_ptr<Bodies> bodies;
  if (options.integrator == Integrator::implicit_euler && !contacts.colliders.empty()) {
    terms.push_back(barrier_ = std::make_shared<BarrierTerm>(contacts));
    terms.push_back(friction_ = std::make_shared<FrictionTerm>(contacts));
    bodies = std::make_unique<Bodies>(contacts, *barrier_, *friction_);
  }
  potential_ = std::make_unique<IncrementalPotential>(masses, pinned, std::move(terms),
                                                      options.threads, std::move(bodies));
  set_contact_stiffness(1.0);
}

void Deformable::set_pinned(std::span<const std::uint8_t> pinned) {
  potential_->set_pinned(pinned);
  targets = positions;
}

void Deformable::assemble(double h, std::span<double> values) {
  std::vector<Vec3> g(positions.size());
  potential_->begin_step(positions, positions, h);
  potential_->assemble(positions, 1.0, g, values);
}

void Deformable::set_threads(int threads) {
  options.threads = threads;
  potential_->set_threads(threads);
}

void Deformable::set_contact_stiffness(double h) {
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const double scale = masses()[i] / (h * h);
    contacts.stiffness[i] = pinned()[i]                       ? 0.0
                            : options.contact_stiffness > 0.0 ? options.contact_stiffness
                                                              : scale;
  }
}

void Deformable::step(double h) {
  const std::vector<Vec3> x = positions, v = velocities;
  const std::vector<geometry::Collider> colliders = contacts.colliders;
  report_ = {};
  try {
    for (std::size_t i = 0; i < positions.size(); ++i) {
      pin_velocities_[i] = (targets[i] - positions[i]) / h;
    }
    const bool is_explicit = options.integrator != Integrator::implicit_euler;
    if (is_explicit) {
      explicit_step(h);
    } else {
      implicit_steps(h, 0);
    }
    for (std::size_t i = 0; i < positions.size(); ++i) {
      if (pinned()[i]) positions[i] = targets[i];
    }
    check_finite(h);
    // Explicit Euler lets undamped modes grow at any step.
    if (is_explicit && options.integrator != Integrator::explicit_euler) check_follows(h, v);
  } catch (...) {
    positions = x;
    velocities = v;
    contacts.colliders = colliders;
    throw;
  }
  time += h;
  forces.assign(forces.size(), Vec3::Zero());
}

Vec3 Deformable::acceleration_without_terms(std::size_t i) const {
  return options.gravity + forces[i] / masses()[i];
}

void Deformable::accelerations(Positions x, Positions v, std::span<Vec3> a) {
  potential_->forces(x, v, a);
  for (std::size_t i = 0; i < a.size(); ++i) {
    a[i] =
        pinned()[i] ? Vec3(Vec3::Zero()) : Vec3(acceleration_without_terms(i) + a[i] / masses()[i]);
  }
}

void Deformable::explicit_step(double h) {
  std::vector<Vec3>&x = positions, &v = velocities;
  for (std::size_t i = 0; i < v.size(); ++i) {
    if (pinned()[i]) v[i] = pin_velocities_[i];
  }
  std::vector<Vec3> a(x.size());
  accelerations(x, v, a);
  switch (options.integrator) {
    case Integrator::explicit_euler:
      move(x, h, v);
      move(v, h, a);
      break;
    case Integrator::semi_implicit_euler:
      move(v, h, a);
      move(x, h, v);
      break;
    case Integrator::velocity_verlet:
      move(v, h / 2, a);
      move(x, h, v);
      accelerations(x, moved(v, h / 2, a), a);  // at the velocity predicted with the old one
      move(v, h / 2, a);
      break;
    default: {  // rk4, on (x, v)' = (v, a)
      std::vector<Vec3> a2(a.size()), a3(a.size()), a4(a.size());
      const std::vector<Vec3> v2 = moved(v, h / 2, a);
      accelerations(moved(x, h / 2, v), v2, a2);
      const std::vector<Vec3> v3 = moved(v, h / 2, a2);
      accelerations(moved(x, h / 2, v2), v3, a3);
      const std::vector<Vec3> v4 = moved(v, h, a3);
      accelerations(moved(x, h, v3), v4, a4);
      for (std::size_t i = 0; i < x.size(); ++i) {
        x[i] += h / 6 * (v[i] + 2 * v2[i] + 2 * v3[i] + v4[i]);
        v[i] += h / 6 * (a[i] + 2 * a2[i] + 2 * a3[i] + a4[i]);
      }
    }
  }
  geometry::accelerate_bodies(contacts.colliders, h);
  for (geometry::Collider& collider : contacts.colliders) collider.advance(h);
  project_contacts(contacts, masses(), x, v);
}

// One step of length h, or, where it fails, two of h / 2.
void Deformable::implicit_steps(double h, int halvings) {
  poll_interrupt();
  const std::vector<Vec3> x = positions, v = velocities;
  const std::vector<geometry::Collider> colliders = contacts.colliders;
  if (implicit_step(h)) return;
  positions = x;
  velocities = v;
  contacts.colliders = colliders;
  if (nearest_.distance <= 0.0 && set_off_vertices(contacts, positions)) {
    return implicit_steps(h, halvings);
  }
  ++report_.failed;
  if (halvings == options.max_halvings) {
    std::ostringstream message;
    if (nearest_.distance <= 0.0) {
      message << "vertex " << nearest_.vertex << " has no place outside of collider "
              << nearest_.collider << " in the step from t = " << time
              << " s, however short: it is " << nearest_.distance
              << " m from it. Move the obstacles apart";
      throw SolverError(message.str(), time, nearest_.vertex);
    }
    message << "implicit Euler did not converge in the step from t = " << time << " s, even in "
            << (std::int64_t{1} << halvings) << " parts: after " << report_.iterations
            << " iterations the largest component of the gradient was " << report_.residuals.back()
            << " N, and it has to come to " << options.tolerance
            << " N. Use a smaller step, a larger tolerance or more iterations";
    ConvergenceError error(message.str(), time);
    error.residuals = report_.residuals;
    throw error;
  }
  std::vector<geometry::Exchange> sums(colliders.size());
  for (int half = 0; half < 2; ++half) {
    implicit_steps(h / 2, halvings + 1);
    add_exchanges(sums, contacts);
  }
  for (std::size_t c = 0; c < sums.size(); ++c) contacts.colliders[c].set_exchange(sums[c]);
}

bool Deformable::implicit_step(double h) {
  const std::vector<Vec3> x_n = positions;
  std::vector<Vec3> x = positions, y(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    y[i] = x_n[i] + h * velocities[i] + h * h * acceleration_without_terms(i);
    if (pinned()[i]) x[i] = y[i] = x_n[i] + h * pin_velocities_[i];
    if (!y[i].allFinite()) throw_not_finite(i, h);
  }
  if (barrier_) {
    move_colliders(h, x);
    nearest_ = closest_vertex(contacts, x, 0.0);
    if (nearest_.distance <= 0.0) return false;  // squeezed: smaller steps
    for (const Vec3& unknown : potential_->bodies()->start()) x.push_back(unknown);
  }
  potential_->begin_step(x_n, y, h);
  start_ahead(h, x);
  if (!minimise(x)) return false;
  for (std::size_t i = 0; i < x_n.size(); ++i) velocities[i] = (x[i] - x_n[i]) / h;
  std::copy_n(x.begin(), positions.size(), positions.begin());  // in place: others look at it
  if (barrier_) {
    set_exchanges(contacts, *barrier_, *friction_, positions, velocities, h);
  }
  if (x.size() > positions.size()) finish_bodies(h, x);
  return true;
}

// Those that do not yield go where they are told, and take vertices along; the others stay for the
// minimisation, as far as they are not held.
void Deformable::move_colliders(double h, std::vector<Vec3>& x) {
  const std::vector<geometry::Collider> before = contacts.colliders;
  for (geometry::Collider& collider : contacts.colliders) {
    if (!collider.yields()) collider.advance(h);
  }
  potential_->bodies()->begin_step(h, masses());
  set_contact_stiffness(h);
  carry_vertices(before, contacts, x);
}

// What is left of the gradient is momentum that nothing gave: vertices lose it, and bodies have the
// velocities that their impulses give them, so that both have exchanged the same, to rounding.
void Deformable::finish_bodies(double h, Positions x) {
  std::vector<Vec3> g(x.size());
  potential_->gradient(x, g);
  for (std::size_t i = 0; i < velocities.size(); ++i) velocities[i] -= h / masses()[i] * g[i];
  potential_->bodies()->push();
}

// The minimisation starts where the vertices would be without forces, if that is a better place: of
// lower energy, and nothing is in the way. There bodies are free; where something touches them they
// go on as they did, as what touches them does.
void Deformable::start_ahead(double h, std::vector<Vec3>& x) {
  std::vector<Vec3> way(x.size());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    way[i] = pinned()[i] ? Vec3(Vec3::Zero()) : Vec3(h * velocities[i]);
  }
  if (x.size() > positions.size()) {
    const Positions vertices = Positions(x).first(positions.size());
    const double thickness = contacts.thickness;
    const bool touching = closest_vertex(contacts, vertices, thickness).distance < thickness;
    const std::vector<Vec3> coasting = potential_->bodies()->coasting();
    for (std::size_t k = positions.size(); k < x.size(); ++k) {
      way[k] = (touching ? coasting[k - positions.size()] : Vec3(Vec3::Zero())) - x[k];
    }
  }
  if (potential_->step_bound(x, way) < 1.0) return;
  const std::vector<Vec3> ahead = moved(x, 1.0, way);
  if (potential_->energy(ahead) < potential_->energy(x)) x = ahead;
}

// Minimises, and lags friction at what was found, until that changes nothing. What a minimum under
// lagged forces is worth is what they are, so that those between the first and the last are found
// roughly only: the step ends where the gradient with friction lagged there is within the
// tolerance.
bool Deformable::minimise(std::span<Vec3> x) {
  for (int lagged = 0;; ++lagged) {
    double goal = options.tolerance;
    if (lagged > 0 && lagged < options.max_friction_iterations) {
      const double left = kLaggedGoal * residual(x);
      if (std::isfinite(left)) goal = std::max(goal, left);
    }
    MinimiserReport found = minimiser_->minimise(*potential_, x, goal);
    ++report_.minimisations;
    report_.iterations += found.iterations;
    report_.factorizations += found.factorizations;
    report_.backtracks += found.backtracks;
    report_.refinements += found.refinements;
    report_.residuals = std::move(found.residuals);
    report_.converged = found.converged;
    if (!found.converged) return false;
    if (!friction_ || (lagged > 0 && found.iterations == 0)) return true;
    if (lagged == options.max_friction_iterations) {
      report_.friction_converged = false;
      return true;
    }
    friction_->lag(x);
  }
}

double Deformable::residual(Positions x) {
  std::vector<Vec3> g(x.size());
  potential_->gradient(x, g);
  return largest_component(g);
}

void Deformable::check_finite(double h) const {
  for (std::size_t i = 0; i < positions.size(); ++i) {
    if (!positions[i].allFinite() || !velocities[i].allFinite()) throw_not_finite(i, h);
  }
}

// An explicit integrator diverges where accelerations grow that are too fast for its step: beyond
// h omega = 2 or h d = 2, of rk4 2 sqrt 2, where every mode grows (docs/stability.md). There is
// such a mode, since quotients of Rayleigh are at most the largest eigenvalue; accelerations, and
// not velocities, since they tell it while most of the energy is that of slow modes.
void Deformable::check_follows(double h, Positions v_before) {
  std::vector<Vec3> a(velocities.size());
  double sum = 0.0, largest = 0.0;
  std::size_t worst = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    a[i] = pinned()[i] ? Vec3(Vec3::Zero()) : Vec3((velocities[i] - v_before[i]) / h);
    const double square = a[i].squaredNorm();
    sum += masses()[i] * square;
    if (square > largest) worst = i;
    largest = std::max(largest, square);
  }
  if (accelerations_of_late_ > 0.0 && sum > kSuspiciousGrowth * accelerations_of_late_) {
    const Spectrum motion = spectrum_of(*potential_, positions, a);
    const double fastest = std::max(motion.frequency, motion.damping_rate);
    const double most = options.integrator == Integrator::rk4 ? std::sqrt(8.0) : 2.0;
    if (h * fastest > most) {
      std::ostringstream message;
      message << "the step from t = " << time << " s diverges, most at vertex " << worst
              << ": h = " << h << " s is beyond the step limit of the integrator, which in this "
              << "shape is below " << most / fastest << " s. Set step_size to half of step_limit() "
              << "or less, or use implicit_euler";
      throw NonFiniteError(message.str(), time, static_cast<std::int64_t>(worst));
    }
  }
  accelerations_of_late_ = std::max(sum, kForgotten * accelerations_of_late_);
}

void Deformable::throw_not_finite(std::size_t i, double h) const {
  std::ostringstream message;
  message << "vertex " << i << " is not finite after the step from t = " << time
          << " s: an input was not, or h = " << h << " s is beyond the step limit of the "
          << "integrator; use a smaller step or implicit_euler";
  throw NonFiniteError(message.str(), time, static_cast<std::int64_t>(i));
}

double Deformable::kinetic_energy() const {
  double sum = 0.0;
  for (std::size_t i = 0; i < velocities.size(); ++i) {
    sum += 0.5 * masses()[i] * velocities[i].squaredNorm();
  }
  return sum;
}

double Deformable::potential_energy() const { return potential_->elastic_energy(positions); }

}  // namespace substep::springs
