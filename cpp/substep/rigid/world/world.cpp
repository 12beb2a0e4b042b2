#include "substep/rigid/world/world.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <sstream>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/reserve.h"
#include "substep/core/usize.h"
#include "substep/rigid/collision/broad_phase.h"
#include "substep/rigid/shapes/mass_properties.h"
#include "substep/rigid/solver/contact_solver.h"
#include "substep/rigid/world/contact_finder.h"
#include "substep/rigid/world/fast_bodies.h"
#include "substep/rigid/world/queries.h"

namespace substep::rigid {
namespace {

constexpr std::int64_t kPlaced = 128;  // bodies of a chunk
// Of the first step, where bodies start at rest on each other, and when impulses stay: the sum of
// their changes, as a part of their sum. A stack of 20 needs about 16 rounds.
constexpr int kMostRounds = 64;
constexpr double kSameImpulses = 1e-3;
constexpr double kTears = 0.1;  // of the size of its bodies, by which a step tears a joint apart
constexpr std::int64_t kMost = std::numeric_limits<std::int32_t>::max();  // bodies, fixtures
constexpr std::int64_t kMostSteps = std::int64_t{1} << 62;                // that a state holds

void check_number(const char* name, double value, double least, bool above) {
  if (std::isfinite(value) && (above ? value > least : value >= least)) return;
  throw InputError(std::string(name) + ": expected a finite number " +
                   (above ? "above " : "not below ") + std::to_string(least) + ", got " +
                   std::to_string(value));
}

void check_options(const WorldOptions& options) {
  if (!options.gravity.allFinite()) throw InputError("gravity: expected finite numbers");
  if (options.contact.substeps < 1) throw InputError("substeps: expected at least 1");
  if (options.contact.sweeps < 1) throw InputError("sweeps: expected at least 1");
  check_number("contact_margin", options.contact_margin, 0, true);
  check_number("slop", options.contact.slop, 0, false);
  check_number("push_speed", options.contact.push_speed, 0, true);
  check_number("settling", options.contact.settling, 0, true);
  check_number("sleep.distance", options.sleep.distance, 0, false);
  check_number("sleep.time", options.sleep.time, 0, true);
}

}  // namespace

World::World(const WorldOptions& options) : options_(options) { check_options(options); }
World::World(const World& other) = default;
World::World(World&& other) noexcept = default;
World& World::operator=(const World& other) = default;
World& World::operator=(World&& other) noexcept = default;
World::~World() = default;

std::int64_t World::impacts() const { return solver_->impacts(); }

void World::set_options(const WorldOptions& options) {
  check_options(options);
  options_ = options;
}

void World::check_body(std::int64_t body) const {
  if (body >= 0 && body < bodies_.size()) return;
  throw InputError("body: expected a number from 0 to " + std::to_string(bodies_.size() - 1) +
                   ", got " + std::to_string(body));
}

void World::make_room(std::int64_t bodies, std::int64_t fixtures) {
  if (bodies_.size() + bodies > kMost || fixtures_.size() + fixtures > kMost)
    throw InputError("a world holds no more bodies");
  const std::size_t n = usize(bodies_.size() + bodies);
  bodies_.make_room(usize(bodies));
  fixtures_.make_room(usize(bodies), usize(fixtures));
  for (auto* rows : {&rest_x_, &rest_q_, &placed_x_, &placed_q_}) reserve_amortised(*rows, 4 * n);
  reserve_amortised(asleep_, n), reserve_amortised(ways_, n);
  islands_.make_room(static_cast<std::int32_t>(n), static_cast<std::int32_t>(bodies));
  broad_phase_->make_room(static_cast<std::int32_t>(fixtures_.size() + fixtures),
                          static_cast<std::int32_t>(fixtures));
}

std::int32_t World::add(const BodyState& body, std::span<const Fixture> fixtures) {
  check_fixtures(fixtures, body.motion);
  if (!std::isfinite(body.position.squaredNorm()))
    throw InputError("position: expected finite numbers below 1e154");
  make_room(1, static_cast<std::int64_t>(fixtures.size()));
  fixtures_.add(fixtures, options_.contact_margin);
  std::int64_t number = 0;
  try {
    number = bodies_.add(body);
  } catch (...) {
    fixtures_.remove_last_body();
    throw;
  }
  // Nothing fails from here on.
  rest_x_.resize(bodies_.x.size()), placed_x_.resize(bodies_.x.size());
  rest_q_.resize(bodies_.q.size()), placed_q_.resize(bodies_.q.size());
  asleep_.push_back(0);
  ways_.emplace_back();
  enter(number);
  return static_cast<std::int32_t>(number);
}

std::int32_t World::add(std::span<const BodyState> bodies, std::span<const Fixture> fixtures) {
  const auto first = bodies_.size(), n = static_cast<std::int64_t>(bodies.size());
  make_room(n, n * static_cast<std::int64_t>(fixtures.size()));
  try {
    for (const BodyState& body : bodies) add(body, fixtures);
  } catch (...) {
    while (bodies_.size() > first) drop_last();
    throw;
  }
  return static_cast<std::int32_t>(first);
}

// As if it had not been added; needs no memory.
void World::drop_last() {
  const std::int64_t body = bodies_.size() - 1;
  if (bodies_.dynamic(body)) islands_.remove(static_cast<std::int32_t>(body));
  for (std::int32_t f = fixtures_.first(body); f < fixtures_.first(body + 1); ++f)
    broad_phase_->remove(f);
  fixtures_.remove_last_body();
  bodies_.remove_last();
  rest_x_.resize(bodies_.x.size()), placed_x_.resize(bodies_.x.size());
  rest_q_.resize(bodies_.q.size()), placed_q_.resize(bodies_.q.size());
  asleep_.pop_back();
  ways_.pop_back();
}

// Makes a body part of broad phase and islands.
void World::enter(std::int64_t body) {
  std::copy_n(&bodies_.x[3 * usize(body)], 3, &rest_x_[3 * usize(body)]);
  std::copy_n(&bodies_.q[4 * usize(body)], 4, &rest_q_[4 * usize(body)]);
  place_body(body, 0);
  if (bodies_.dynamic(body)) islands_.add(static_cast<std::int32_t>(body));
  for (std::int32_t f = fixtures_.first(body); f < fixtures_.first(body + 1); ++f)
    add_to_broad_phase(f);
}

void World::add_to_broad_phase(std::int32_t f) {
  const Fixture& fixture = fixtures_[f].fixture;
  const std::int32_t body = fixtures_[f].body;
  const BroadPhase::Proxy proxy{body, bodies_.motion[usize(body)], fixture.group, fixture.mask};
  if (const auto* plane = std::get_if<Plane>(&fixture.shape)) {
    const Vec3 normal = fixtures_.pose(f).rotation * plane->normal;
    const double offset = plane->offset + normal.dot(fixtures_.pose(f).position);
    broad_phase_->add_plane(f, proxy, normal, offset);
  } else {
    broad_phase_->add(f, proxy, fixtures_.bounds()[usize(f)]);
  }
}

// Wakes what the bodies touch and takes them out.
void World::leave(std::span<const std::int64_t> bodies) {
  std::vector<std::uint8_t> leaves(usize(bodies_.size()), 0);
  for (const std::int64_t body : bodies) leaves[usize(body)] = 1;
  for (const auto* list : {&contacts_, &sleeping_contacts_}) {
    for (const ContactConstraint& c : *list) {
      if (leaves[usize(c.a)] != 0) wake(c.b);
      if (leaves[usize(c.b)] != 0) wake(c.a);
    }
  }
  for (const Joint& joint : joints_)
    if (leaves[usize(joint.a)] != 0 || (joint.b >= 0 && leaves[usize(joint.b)] != 0))
      wake_joined(joint);
  for (const std::int64_t body : bodies) {
    if (bodies_.dynamic(body)) {
      wake(body);
      islands_.remove(static_cast<std::int32_t>(body));
    }
    for (std::int32_t f = fixtures_.first(body); f < fixtures_.first(body + 1); ++f)
      broad_phase_->remove(f);
  }
}

std::vector<std::int64_t> World::remove(std::span<const std::int64_t> removed) {
  for (const std::int64_t body : removed) check_body(body);
  std::vector<std::int64_t> once(removed.begin(), removed.end());
  std::sort(once.begin(), once.end());
  once.erase(std::unique(once.begin(), once.end()), once.end());
  World others(*this);  // where memory runs out, this one is as before
  std::vector<std::int64_t> numbers = others.take_out(once);
  *this = std::move(others);
  return numbers;
}

std::vector<std::int64_t> World::take_out(std::span<const std::int64_t> removed) {
  leave(removed);
  std::vector<std::int64_t> numbers = bodies_.remove(removed);
  const std::vector<std::int32_t> fixtures = fixtures_.renumber(numbers);
  const std::vector<std::int32_t> bodies(numbers.begin(), numbers.end());
  broad_phase_->renumber(fixtures, bodies);
  islands_.renumber(bodies);
  const auto compact = [&](auto& rows, std::size_t width) {
    for (std::size_t b = 0; b < bodies.size(); ++b)
      for (std::size_t k = 0; bodies[b] >= 0 && k < width; ++k)
        rows[usize(bodies[b]) * width + k] = rows[b * width + k];
    rows.resize(usize(bodies_.size()) * width);
  };
  compact(rest_x_, 3), compact(placed_x_, 3), compact(rest_q_, 4), compact(placed_q_, 4);
  compact(asleep_, 1), compact(ways_, 1);
  const auto number = [&](std::int32_t& body) { body = bodies[usize(body)]; };
  for (auto* list : {&contacts_, &sleeping_contacts_}) {
    std::erase_if(*list, [&](ContactConstraint& c) {
      number(c.a), number(c.b);
      c.fixture_a = fixtures[usize(c.fixture_a)], c.fixture_b = fixtures[usize(c.fixture_b)];
      return c.a < 0 || c.b < 0;
    });
  }
  std::erase_if(excluded_, [&](BodyPair& pair) {
    number(pair.a), number(pair.b);
    return pair.a < 0 || pair.b < 0;
  });
  std::erase_if(joints_, [&](Joint& joint) {
    number(joint.a);
    if (joint.b < 0) return joint.a < 0;
    number(joint.b);
    return joint.a < 0 || joint.b < 0;
  });
  excluded_changed_ = true;
  for (std::int32_t& body : displaced_) number(body);
  std::erase(displaced_, -1);
  return numbers;
}

void World::set_motion(std::int64_t body, Motion motion, double mass, const Vec3& inertia) {
  check_body(body);
  const bool dynamic = motion == Motion::kDynamic;
  if (dynamic) {
    check_number("mass", mass, 0, true);
    check_principal_moments(inertia, "inertia");
  }
  for (std::int32_t f = fixtures_.first(body); f < fixtures_.first(body + 1); ++f)
    if (motion != Motion::kStatic && is_ground(fixtures_[f].fixture.shape))
      throw InputError("motion: only a static body may have a plane or a mesh");
  const Vec3 v = bodies_.velocity(body), w = bodies_.angular_velocity(body);
  const bool still = motion == Motion::kStatic;
  leave({&body, 1});
  bodies_.motion[usize(body)] = motion;
  bodies_.mass[usize(body)] = dynamic ? mass : 1;
  Vec3::Map(&bodies_.inertia[3 * usize(body)]) = dynamic ? inertia : Vec3::Ones();
  bodies_.set_velocity(body, still ? Vec3::Zero() : v, still ? Vec3::Zero() : w);
  enter(body);
  for (auto* list : {&contacts_, &sleeping_contacts_}) {
    std::erase_if(*list, [&](const ContactConstraint& c) {
      return !bodies_.dynamic(c.a) && !bodies_.dynamic(c.b);
    });
  }
}

void World::exclude(std::int32_t a, std::int32_t b, bool excluded) {
  check_body(a), check_body(b);
  reserve_amortised(excluded_, excluded_.size() + 1);
  wake(a), wake(b);
  std::erase_if(excluded_, [&](const BodyPair& pair) {
    return std::minmax(pair.a, pair.b) == std::minmax(a, b);
  });
  if (excluded) excluded_.push_back({a, b});
  excluded_changed_ = true;
}

void World::show_excluded() {
  if (!excluded_changed_) return;
  std::vector<BodyPair> pairs = excluded_;
  for (const Joint& joint : joints_)
    if (!joint.collide && joint.b >= 0) pairs.push_back({joint.a, joint.b});
  broad_phase_->exclude(std::move(pairs));
  excluded_changed_ = false;
}

void World::wake_joined(const Joint& joint) {
  wake(joint.a);
  if (joint.b >= 0) wake(joint.b);
}

void World::check_joint_number(std::int64_t number) const {
  const auto n = static_cast<std::int64_t>(joints_.size());
  if (number >= 0 && number < n) return;
  throw InputError("joint: expected a number from 0 to " + std::to_string(n - 1) + ", got " +
                   std::to_string(number));
}

void World::set_material_pair(const MaterialPair& pair) {
  const auto known = [&](const std::string& name) {
    for (std::int32_t f = 0; f < fixtures_.size(); ++f)
      if (fixtures_[f].fixture.material == name) return true;
    const auto pairs = material_pairs();
    return std::any_of(pairs.begin(), pairs.end(),
                       [&](const MaterialPair& p) { return p.a == name || p.b == name; });
  };
  for (const std::string* name : {&pair.a, &pair.b})
    if (name->empty() || !known(*name))
      throw InputError("material: no shape is of '" + *name + "'");
  fixtures_.set_material_pair(pair);
  for (std::int64_t b = 0; b < bodies_.size(); ++b) wake(b);
}

std::int32_t World::add_joint(const Joint& joint) {
  check_joint(joint, bodies_);
  joints_.push_back(joint);
  wake_joined(joint);
  excluded_changed_ = true;
  return static_cast<std::int32_t>(joints_.size()) - 1;
}

void World::set_joint(std::int64_t number, const Joint& joint) {
  check_joint_number(number);
  check_joint(joint, bodies_);
  wake_joined(joints_[usize(number)]);
  joints_[usize(number)] = joint;
  wake_joined(joint);
  excluded_changed_ = true;
}

void World::remove_joints(std::span<const std::int64_t> numbers) {
  std::vector<std::uint8_t> removed(joints_.size(), 0);
  for (const std::int64_t number : numbers) {
    check_joint_number(number);
    removed[usize(number)] = 1;
  }
  std::size_t kept = 0;
  for (std::size_t k = 0; k < joints_.size(); ++k) {
    if (removed[k] != 0) {
      wake_joined(joints_[k]);
    } else {
      joints_[kept++] = joints_[k];
    }
  }
  joints_.resize(kept);
  excluded_changed_ = true;
}

void World::step(double dt) {
  check_number("dt", dt, 0, true);
  remember();
  try {
    place(dt);
    do {
      find_contacts();
    } while (wake_touched(dt));
    solve(dt);
    check_joints(dt);
    if (options_.continuous)
      stop_fast_bodies(active_, fixtures_, *broad_phase_, options_.gravity, bodies_);
    fall_asleep(dt);
  } catch (...) {
    go_back();
    throw;
  }
  bodies_.clear_forces();
  displaced_.clear();
  time += dt;
  steps = std::min(steps + 1, kMostSteps);
}

void World::remember() {
  poll_interrupt();
  before_.x = bodies_.x, before_.q = bodies_.q, before_.P = bodies_.P, before_.L = bodies_.L;
  before_.rest_x = rest_x_, before_.rest_q = rest_q_;
  before_.placed_x = placed_x_, before_.placed_q = placed_q_;
  before_.joints = joints_;
  before_.islands = islands_;
  sort_contacts(contacts_);
  last_contacts_.swap(contacts_);
}

// A joint is torn by a step after which it is off by more than its bodies are large, and by more
// than before.
void World::check_joints(double dt) const {
  const auto size_of = [&](std::int32_t body, const Joint::Frame& frame) {
    if (body < 0 || !bodies_.dynamic(body)) return 0.0;
    const double inertia = Vec3(&bodies_.inertia[3 * usize(body)]).sum() / 2;
    return frame.anchor.norm() + std::sqrt(inertia / bodies_.mass[usize(body)]);
  };
  std::optional<Bodies> begin;
  for (std::size_t j = 0; j < joints_.size(); ++j) {
    const Joint& joint = joints_[j];
    const double size = size_of(joint.a, joint.in_a) + size_of(joint.b, joint.in_b);
    if (!(joint.length_error > size)) continue;
    if (!begin) {
      begin = bodies_;
      begin->x = before_.x, begin->q = before_.q;
    }
    if (!(joint.length_error > joint_gap(joint, *begin) + kTears * size)) continue;
    std::ostringstream text;
    text << "joint " << j << ": it would be torn apart by " << joint.length_error
         << " m in a step of " << dt
         << " s, in which its bodies are turned or thrown too far; take a shorter step or more "
            "substeps, or damp what drives it";
    throw SolverError(text.str(), time, static_cast<std::int64_t>(j), steps);
  }
}

// The rows of bodies stay where they are in memory: others may look at them.
void World::go_back() {
  bodies_.x = before_.x, bodies_.q = before_.q, bodies_.P = before_.P, bodies_.L = before_.L;
  rest_x_.swap(before_.rest_x), rest_q_.swap(before_.rest_q);
  placed_x_.swap(before_.placed_x), placed_q_.swap(before_.placed_q);
  displaced_.clear();
  joints_.swap(before_.joints);
  std::swap(islands_, before_.islands);
  last_contacts_.swap(contacts_);
  for (std::int64_t b = 0; b < bodies_.size(); ++b) show_sleep(b);
}

// Where all that may move is, and how far it will go.
void World::place(double dt) {
  note_changes();
  sort_contacts(last_contacts_);  // those of what woke
  active_.clear();
  for (std::int64_t b = 0; b < bodies_.size(); ++b) {
    if (bodies_.motion[usize(b)] == Motion::kStatic || asleep_[usize(b)] != 0) continue;
    active_.push_back(static_cast<std::int32_t>(b));
    if (bodies_.dynamic(b)) continue;
    for (std::int32_t f = fixtures_.first(b); f < fixtures_.first(b + 1); ++f)
      broad_phase_->set_awake(f, moves_now(b));
  }
  parallel_for(
      static_cast<std::int64_t>(active_.size()), kPlaced,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          check_row(active_[usize(k)]);
          place_body(active_[usize(k)], dt);
        }
      },
      threads);
  for (const std::int32_t b : active_) list_fixtures(b);
}

void World::list_fixtures(std::int64_t body) {
  for (std::int32_t f = fixtures_.first(body); f < fixtures_.first(body + 1); ++f)
    moving_.push_back(f);
}

void World::place_body(std::int64_t body, double dt) {
  const std::size_t b = usize(body);
  Way& way = ways_[b];
  way = {};
  if (dt > 0 && bodies_.motion[b] != Motion::kStatic) {
    way.travel = dt * bodies_.velocity(body);
    way.turn = dt * bodies_.angular_velocity(body);
  }
  if (dt > 0 && bodies_.dynamic(body)) {
    const Vec3 a = options_.gravity + Vec3(&bodies_.force[3 * b]) / bodies_.mass[b];
    const Vec3 torque(&bodies_.torque[3 * b]);
    way.travel += dt * dt * a;
    if (!torque.isZero(0)) way.turn += dt * dt * (bodies_.inverse_inertia(body) * torque);
  }
  way.angle = way.turn.norm();
  fixtures_.place(body, bodies_.pose(body), way);
  std::copy_n(&bodies_.x[3 * b], 3, &placed_x_[3 * b]);
  std::copy_n(&bodies_.q[4 * b], 4, &placed_q_[4 * b]);
}

// What was written into the rows.
void World::check_row(std::int64_t body) {
  const std::size_t b = usize(body);
  const double all = Vec3(&bodies_.x[3 * b]).squaredNorm() + Vec3(&bodies_.P[3 * b]).squaredNorm() +
                     Vec3(&bodies_.L[3 * b]).squaredNorm() +
                     Vec3(&bodies_.force[3 * b]).squaredNorm() +
                     Vec3(&bodies_.torque[3 * b]).squaredNorm();
  const Quaternion q = bodies_.rotation(body);
  const double square = q.squaredNorm();
  if (!std::isfinite(all + square) || square == 0) {
    throw NonFiniteError("body " + std::to_string(body) +
                             ": its position, rotation, momenta or forces are not finite, or too "
                             "large; write finite ones",
                         time, body, steps);
  }
  if (std::abs(square - 1) > 1e-12) store_quaternion(q.normalized(), &bodies_.q[4 * b]);
}

void World::find_contacts() {
  broad_phase_->update(moving_, fixtures_.bounds(), threads);
  moving_.clear();
  finder_->find(broad_phase_->pairs(), broad_phase_->slots(), fixtures_, bodies_.motion, ways_,
                last_contacts_, options_.continuous, contacts_, threads);
}

void World::solve(double dt) {
  // Of a moving kinematic body with one that sleeps on.
  if (any_asleep()) {
    std::erase_if(contacts_,
                  [&](const ContactConstraint& c) { return !is_awake(c.a) && !is_awake(c.b); });
  }
  const std::vector<std::uint8_t> at_rest = contacts_at_rest();
  const std::int64_t bad = at_rest.empty() ? solve_once(dt) : solve_from_rest(dt, at_rest);
  if (bad < 0) return;
  throw NonFiniteError("body " + std::to_string(bad) +
                           ": its motion is not finite after a step of " + std::to_string(dt) +
                           " s; take a smaller step, or see that its velocity, mass and the forces "
                           "on it are in proportion",
                       time, bad, steps);
}

std::int64_t World::solve_once(double dt) {
  const auto touch = [&](const Pose& a, const Pose& b, ContactConstraint& contact) {
    return ContactFinder::touch_at(fixtures_, bodies_.motion, a, b, contact);
  };
  return solver_->step(bodies_, options_.gravity, dt, contacts_, options_.contact, asleep_, joints_,
                       threads, touch, [&](const ContactConstraint& contact) {
                         return ContactFinder::round_pair(fixtures_, bodies_.motion, contact);
                       });
}

// Of each contact, 1: its bodies were put down on each other. They press, but nobody told how much.
// Empty if there is none.
std::vector<std::uint8_t> World::contacts_at_rest() const {
  if (!last_contacts_.empty() || !sleeping_contacts_.empty() || contacts_.empty()) return {};
  std::vector<BodyPair> pairs;
  const auto connect = [&](std::int32_t a, std::int32_t b) {
    if (b >= 0 && bodies_.dynamic(a) && bodies_.dynamic(b)) pairs.push_back({a, b});
  };
  for (const ContactConstraint& c : contacts_) connect(c.a, c.b);
  for (const Joint& joint : joints_) connect(joint.a, joint.b);
  std::vector<std::int32_t> island(usize(bodies_.size()));
  label_islands(pairs, island);
  std::vector<std::uint8_t> moves(island.size());
  const auto rests = [&](std::int32_t b) {
    return Vec3(&bodies_.P[3 * usize(b)]).isZero(0) && Vec3(&bodies_.L[3 * usize(b)]).isZero(0);
  };
  const auto note = [&](std::int32_t a, std::int32_t b) {
    if (b < 0 || (rests(a) && rests(b))) return;
    for (const std::int32_t c : {a, b})
      if (bodies_.dynamic(c)) moves[usize(island[usize(c)])] = 1;
  };
  for (const ContactConstraint& c : contacts_) note(c.a, c.b);
  for (const Joint& joint : joints_) note(joint.a, joint.b);
  std::vector<std::uint8_t> found;
  for (const ContactConstraint& c : contacts_)
    found.push_back(moves[usize(island[usize(bodies_.dynamic(c.a) ? c.a : c.b)])] == 0);
  if (std::find(found.begin(), found.end(), 1) == found.end()) found.clear();
  return found;
}

// The same step again and again, each time with the impulses that contacts at rest had in the last,
// until these stay. All of them stick so long; if some have less friction where they slip, once
// more with that.
std::int64_t World::solve_from_rest(double dt, const std::vector<std::uint8_t>& at_rest) {
  const std::vector<ContactConstraint> begun = contacts_;
  const std::vector<double> x = bodies_.x, q = bodies_.q, P = bodies_.P, L = bodies_.L;
  std::vector<Joint> joints = joints_;
  const auto back = [&] {
    bodies_.x = x, bodies_.q = q, bodies_.P = P, bodies_.L = L;
    for (std::size_t j = 0; j < joints_.size(); ++j) joints[j].impulse = joints_[j].impulse;
    joints_ = joints;
    for (std::size_t c = 0; c < contacts_.size(); ++c)
      if (!at_rest[c]) contacts_[c] = begun[c];
  };
  bool slips = false;
  for (std::size_t c = 0; c < contacts_.size(); ++c) {
    if (!at_rest[c]) continue;
    slips |= sticks_more(contacts_[c]);
    contacts_[c].friction = contacts_[c].mu();
  }
  std::vector<double> impulses(contacts_.size(), 0);
  for (int round = 1;; ++round) {
    const std::int64_t bad = solve_once(dt);
    double sum = 0, change = 0;
    for (std::size_t c = 0; c < contacts_.size(); ++c) {
      if (!at_rest[c]) continue;
      double l = 0;
      for (int k = 0; k < contacts_[c].count; ++k) l += contacts_[c].points[k].impulse;
      sum += l;
      change += std::abs(l - std::exchange(impulses[c], l));
    }
    const bool last = bad >= 0 || round == kMostRounds || change <= kSameImpulses * sum;
    if (last && !slips) return bad;
    back();
    if (last) break;
  }
  for (std::size_t c = 0; c < contacts_.size(); ++c) contacts_[c].friction = begun[c].friction;
  return solve_once(dt);
}

Scene World::scene() {
  note_changes();
  for (std::int64_t b = 0; b < bodies_.size(); ++b) {
    if (!displaced(b) && ways_[usize(b)].travel.isZero(0) && ways_[usize(b)].turn.isZero(0))
      continue;
    check_row(b);
    place_body(b, 0);
    list_fixtures(b);
  }
  broad_phase_->update(moving_, fixtures_.bounds(), threads);
  moving_.clear();
  return {*broad_phase_, [this](std::int32_t f) {
            const Fixture& fixture = fixtures_[f].fixture;
            return PlacedShape{&fixture.shape, fixtures_.pose(f), fixture.group};
          }};
}

}  // namespace substep::rigid
