// World: its state, and from a state.
#include <algorithm>
#include <cmath>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/rigid/world/world.h"

namespace substep::rigid {
namespace {

void require(bool holds, const char* what) {
  if (!holds) throw InputError(std::string("state: ") + what);
}

void check_state(const WorldState& state) {
  const Bodies& bodies = state.bodies;
  const auto n = usize(bodies.size());
  const auto many = [](const auto& rows, std::size_t size) { return rows.size() == size; };
  require(many(bodies.x, 3 * n) && many(bodies.q, 4 * n) && many(bodies.P, 3 * n) &&
              many(bodies.L, 3 * n) && many(bodies.inertia, 3 * n) && many(bodies.force, 3 * n) &&
              many(bodies.torque, 3 * n) && many(bodies.motion, n) && many(state.slow_time, n) &&
              many(state.island, n) && many(state.rest_x, 3 * n) && many(state.rest_q, 4 * n) &&
              many(state.placed_x, 3 * n) && many(state.placed_q, 4 * n),
          "the rows of bodies are not as many as the bodies");
  const auto is_body = [&](std::int32_t b) { return b >= 0 && b < bodies.size(); };
  require(many(state.fixture_body, state.fixtures.size()) &&
              std::is_sorted(state.fixture_body.begin(), state.fixture_body.end()) &&
              std::all_of(state.fixture_body.begin(), state.fixture_body.end(), is_body),
          "the bodies of the fixtures must be there, in their order");
  for (std::size_t f = 0; f < state.fixtures.size(); ++f)
    check_fixtures(std::span(&state.fixtures[f], 1), bodies.motion[usize(state.fixture_body[f])]);
  for (const BodyPair& pair : state.excluded)
    require(is_body(pair.a) && is_body(pair.b), "an excluded pair has no such body");
  for (const Joint& joint : state.joints) check_joint(joint, bodies);
  for (std::size_t b = 0; b < n; ++b) {
    const bool dynamic = bodies.motion[b] == Motion::kDynamic;
    require(dynamic != (state.island[b] == Islands::kNoBody),
            "dynamic bodies, and no others, belong to an island");
    require(state.island[b] < 0 || is_body(state.island[b]), "there is no island of that number");
  }
  const auto fixtures = static_cast<std::int32_t>(state.fixtures.size());
  for (const ContactConstraint& c : state.contacts) {
    const bool there = c.fixture_a >= 0 && c.fixture_a < fixtures && c.fixture_b >= 0 &&
                       c.fixture_b < fixtures && c.count >= 0 && c.count <= 4;
    require(there, "a contact has no such fixtures or points");
    require(c.a == state.fixture_body[usize(c.fixture_a)] &&
                c.b == state.fixture_body[usize(c.fixture_b)],
            "the bodies of a contact are not those of its fixtures");
    require(c.a != c.b && (bodies.dynamic(c.a) || bodies.dynamic(c.b)),
            "a contact needs two bodies, one of them dynamic");
    const auto unit = [](const Vec3& v) { return std::abs(v.norm() - 1) < 1e-6; };
    require(unit(c.normal) && unit(c.tangent), "directions of a contact have the length 1");
    require(c.friction >= 0 && c.restitution >= 0 && c.restitution <= 1 && c.spinning >= 0 &&
                c.rolling >= 0,
            "friction of a contact is at least 0, restitution from 0 to 1");
    require(c.static_friction >= 0 && Vec3::Map(c.slip).allFinite(),
            "static friction of a contact is at least 0, its slip is finite");
    require(c.load >= 0, "the load of a contact is at least 0");
  }
  require(std::is_sorted(state.contacts.begin(), state.contacts.end(), precedes),
          "contacts are in the order of their shapes");
}

}  // namespace

WorldState World::state() const {
  WorldState state;
  state.time = time;
  state.steps = steps;
  state.bodies = bodies_;
  for (std::int32_t f = 0; f < fixtures_.size(); ++f) {
    state.fixtures.push_back(fixtures_[f].fixture);
    state.fixture_body.push_back(fixtures_[f].body);
  }
  state.excluded = excluded_;
  state.material_pairs.assign(material_pairs().begin(), material_pairs().end());
  state.joints = joints_;
  state.contacts.resize(contacts_.size() + sleeping_contacts_.size());
  std::merge(
      contacts_.begin(), contacts_.end(), sleeping_contacts_.begin(), sleeping_contacts_.end(),
      state.contacts.begin(), [](const ContactConstraint& c, const ContactConstraint& d) {
        return c.fixture_a != d.fixture_a ? c.fixture_a < d.fixture_a : c.fixture_b < d.fixture_b;
      });
  state.slow_time.assign(islands_.slow_time().begin(), islands_.slow_time().end());
  state.slow_time.resize(usize(bodies_.size()), 0);
  state.island.assign(islands_.island().begin(), islands_.island().end());
  state.island.resize(usize(bodies_.size()), Islands::kNoBody);
  state.rest_x = rest_x_;
  state.rest_q = rest_q_;
  state.placed_x = placed_x_;
  state.placed_q = placed_q_;
  return state;
}

void World::restore(const WorldState& state) {
  check_state(state);
  World other(options_);
  other.bodies_ = state.bodies;
  other.rest_x_ = other.placed_x_ = state.placed_x;
  other.rest_q_ = other.placed_q_ = state.placed_q;
  other.asleep_.assign(usize(state.bodies.size()), 0);
  other.ways_.resize(usize(state.bodies.size()));
  for (std::int64_t b = 0; b < state.bodies.size(); ++b) other.check_row(b);
  const auto swap_places = [&] {
    other.bodies_.x.swap(other.before_.x), other.bodies_.q.swap(other.before_.q);
  };
  other.before_.x = state.placed_x, other.before_.q = state.placed_q;
  swap_places();  // fixtures begin where they were placed
  std::size_t f = 0;
  for (std::int64_t b = 0; b < state.bodies.size(); ++b) {
    std::size_t end = f;
    while (end < state.fixtures.size() && state.fixture_body[end] == b) ++end;
    other.fixtures_.add(std::span(state.fixtures).subspan(f, end - f), options_.contact_margin);
    other.check_row(b);
    other.enter(b);
    f = end;
  }
  swap_places();
  for (const MaterialPair& pair : state.material_pairs) other.fixtures_.set_material_pair(pair);
  other.excluded_ = state.excluded;
  other.joints_ = state.joints;
  other.excluded_changed_ = true;
  other.rest_x_ = state.rest_x;
  other.rest_q_ = state.rest_q;
  other.contacts_ = state.contacts;
  other.islands_.restore(state.slow_time, state.island);
  for (std::int64_t b = 0; b < state.bodies.size(); ++b) other.show_sleep(b);
  other.time = state.time;
  other.steps = state.steps;
  other.threads = threads;
  *this = std::move(other);
}

}  // namespace substep::rigid
