#include "substep/rigid/world.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "substep/core/errors.h"

namespace substep::rigid {
namespace {

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
  check_number("sleep.speed", options.sleep.speed, 0, false);
  check_number("sleep.time", options.sleep.time, 0, true);
}

}  // namespace

World::World(const WorldOptions& options_) : options(options_) { check_options(options); }

std::int32_t World::add(const BodyState& body, std::span<const Fixture> fixtures) {
  check_fixtures(fixtures, body.motion);
  const std::int64_t number = bodies_.add(body);
  fixtures_.add(fixtures, options.contact_margin);
  fixtures_.place(number, bodies_.pose(number), {});
  add_to_broad_phase(number);
  return static_cast<std::int32_t>(number);
}

void World::add_to_broad_phase(std::int64_t body) {
  for (std::int32_t f = fixtures_.first(body); f < fixtures_.first(body + 1); ++f) {
    const Fixture& fixture = fixtures_[f].fixture;
    const BroadPhase::Proxy proxy{static_cast<std::int32_t>(body),
                                  bodies_.motion[static_cast<std::size_t>(body)], fixture.group,
                                  fixture.mask};
    if (const auto* plane = std::get_if<Plane>(&fixture.shape)) {
      const Vec3 normal = fixtures_.pose(f).rotation * plane->normal;
      broad_phase_.add_plane(f, proxy, normal,
                             plane->offset + normal.dot(fixtures_.pose(f).position));
    } else {
      broad_phase_.add(f, proxy, fixtures_.bounds()[static_cast<std::size_t>(f)]);
    }
  }
}

void World::remove(std::span<const std::int64_t> bodies) {
  const std::vector<std::int64_t> numbers = bodies_.remove(bodies);
  for (std::size_t b = 0; b < numbers.size(); ++b) {
    if (numbers[b] >= 0) continue;
    for (std::int32_t f = fixtures_.first(static_cast<std::int64_t>(b));
         f < fixtures_.first(static_cast<std::int64_t>(b) + 1); ++f)
      broad_phase_.remove(f);
  }
  const std::vector<std::int32_t> fixtures = fixtures_.renumber(numbers);
  const std::vector<std::int32_t> of_bodies(numbers.begin(), numbers.end());
  broad_phase_.renumber(fixtures, of_bodies);
  const auto body = [&](std::int32_t& b) { b = of_bodies[static_cast<std::size_t>(b)]; };
  std::erase_if(contacts_, [&](ContactConstraint& c) {
    body(c.a), body(c.b);
    c.fixture_a = fixtures[static_cast<std::size_t>(c.fixture_a)];
    c.fixture_b = fixtures[static_cast<std::size_t>(c.fixture_b)];
    return c.a < 0 || c.b < 0;
  });
  std::erase_if(excluded_, [&](BodyPair& pair) {
    body(pair.a), body(pair.b);
    return pair.a < 0 || pair.b < 0;
  });
}

void World::exclude(std::int32_t a, std::int32_t b) {
  for (const std::int32_t body : {a, b})
    if (body < 0 || body >= bodies_.size())
      throw InputError("body: expected a number from 0 to " + std::to_string(bodies_.size() - 1) +
                       ", got " + std::to_string(body));
  excluded_.push_back({a, b});
  broad_phase_.exclude(excluded_);
}

// Where everything is, and how far it will go.
void World::place(double dt) {
  const std::int64_t n = bodies_.size();
  ways_.assign(static_cast<std::size_t>(n), {});
  moving_.clear();
  for (std::int64_t b = 0; b < n; ++b) {
    const auto k = static_cast<std::size_t>(b);
    Way& way = ways_[k];
    if (bodies_.motion[k] != Motion::kStatic) {
      way.travel = dt * bodies_.velocity(b);
      way.turn = dt * bodies_.angular_velocity(b);
    }
    if (bodies_.dynamic(b)) {
      way.travel += dt * dt * (options.gravity + Vec3(&bodies_.force[3 * k]) / bodies_.mass[k]);
    }
    fixtures_.place(b, bodies_.pose(b), way);
    for (std::int32_t f = fixtures_.first(b); f < fixtures_.first(b + 1); ++f) moving_.push_back(f);
  }
}

void World::step(double dt) {
  check_number("dt", dt, 0, true);
  place(dt);
  broad_phase_.update(moving_, fixtures_.bounds(), threads);
  last_contacts_.swap(contacts_);
  finder_.find(broad_phase_.pairs(), broad_phase_.slots(), fixtures_, ways_, last_contacts_,
               contacts_, threads);
  const std::int64_t bad =
      solver_.step(bodies_, options.gravity, dt, contacts_, options.contact, {}, {}, threads);
  if (bad >= 0) {
    contacts_.swap(last_contacts_);
    throw NonFiniteError("body " + std::to_string(bad) + " is not finite", time, bad, steps);
  }
  bodies_.clear_forces();
  time += dt;
  ++steps;
}

Scene World::scene() const {
  return {broad_phase_, [this](std::int32_t f) {
            const Fixture& fixture = fixtures_[f].fixture;
            const Pose body = bodies_.pose(fixtures_[f].body);
            return PlacedShape{&fixture.shape, body * fixture.local, fixture.group};
          }};
}

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
  state.contacts = contacts_;
  return state;
}

void World::restore(const WorldState& state) {
  World other(options);
  other.bodies_ = state.bodies;
  std::size_t f = 0;
  for (std::int64_t b = 0; b < state.bodies.size(); ++b) {
    std::size_t end = f;
    while (end < state.fixtures.size() && state.fixture_body[end] == b) ++end;
    other.fixtures_.add(std::span(state.fixtures).subspan(f, end - f), options.contact_margin);
    other.fixtures_.place(b, state.bodies.pose(b), {});
    other.add_to_broad_phase(b);
    f = end;
  }
  other.excluded_ = state.excluded;
  other.broad_phase_.exclude(state.excluded);
  other.contacts_ = state.contacts;
  other.time = state.time;
  other.steps = state.steps;
  other.threads = threads;
  *this = std::move(other);
}

}  // namespace substep::rigid
