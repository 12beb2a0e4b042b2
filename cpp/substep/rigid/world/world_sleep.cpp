// World: who sleeps and who wakes.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "substep/core/usize.h"
#include "substep/rigid/collision/broad_phase.h"
#include "substep/rigid/world/world.h"

namespace substep::rigid {
namespace {

bool touches(const ContactConstraint& contact) {
  for (int k = 0; k < contact.count; ++k)
    if (contact.points[k].separation <= 0 || contact.points[k].impulse > 0) return true;
  return false;
}

// Whether bodies that go these ways meet at the contact.
bool meets(const ContactConstraint& contact, const Way& a, const Way& b) {
  for (int k = 0; k < contact.count; ++k) {
    const ContactConstraint::Point& p = contact.points[k];
    const double approach =
        contact.normal.dot((b.travel + b.turn.cross(p.arm_b)) - (a.travel + a.turn.cross(p.arm_a)));
    if (p.separation + std::min(approach, 0.0) <= 0) return true;
  }
  return false;
}

}  // namespace

bool World::is_awake(std::int64_t body) const {
  return bodies_.dynamic(body) && asleep_[usize(body)] == 0;
}

bool World::any_asleep() const {
  return std::find(asleep_.begin(), asleep_.end(), 1) != asleep_.end();
}

bool World::moves_now(std::int64_t body) const {
  if (bodies_.motion[usize(body)] != Motion::kKinematic) return is_awake(body);
  const Vec3 P(&bodies_.P[3 * usize(body)]), L(&bodies_.L[3 * usize(body)]);
  return !P.isZero(0) || !L.isZero(0);
}

bool World::displaced(std::int64_t body) const {
  const std::size_t b = usize(body);
  return std::memcmp(&bodies_.x[3 * b], &placed_x_[3 * b], 3 * sizeof(double)) != 0 ||
         std::memcmp(&bodies_.q[4 * b], &placed_q_[4 * b], 4 * sizeof(double)) != 0;
}

void World::wake(std::int64_t body) {
  if (!bodies_.dynamic(body)) return;
  const std::size_t known = islands_.woken().size();
  islands_.wake(static_cast<std::int32_t>(body));
  for (const std::int32_t member : islands_.woken().subspan(known)) {
    show_sleep(member);
    woken_.push_back(member);
  }
}

void World::show_sleep(std::int64_t body) {
  const bool asleep = bodies_.dynamic(body) && islands_.asleep(static_cast<std::int32_t>(body));
  if (asleep == (asleep_[usize(body)] != 0)) return;
  asleep_[usize(body)] = asleep ? 1 : 0;
  for (std::int32_t f = fixtures_.first(body); f < fixtures_.first(body + 1); ++f)
    broad_phase_->set_awake(f, !asleep);
  sleep_changed_ = true;
}

// What was done to bodies that are at rest.
void World::note_changes() {
  show_excluded();
  const auto zero = [](const std::vector<double>& rows, std::size_t b) {
    return Vec3(&rows[3 * b]).isZero(0);
  };
  for (std::int64_t body = 0; body < bodies_.size(); ++body) {
    const std::size_t b = usize(body);
    if (asleep_[b] != 0) {
      const bool still = zero(bodies_.P, b) && zero(bodies_.L, b) && zero(bodies_.force, b) &&
                         zero(bodies_.torque, b);
      if (!options_.sleeping || !still || displaced(body)) wake(body);
    } else if (bodies_.motion[b] != Motion::kDynamic && displaced(body)) {
      check_row(body);
      place_body(body, 0);
      displaced_.push_back(static_cast<std::int32_t>(body));
      for (std::int32_t f = fixtures_.first(body); f < fixtures_.first(body + 1); ++f) {
        if (std::holds_alternative<Plane>(fixtures_[f].fixture.shape)) {
          broad_phase_->remove(f);
          add_to_broad_phase(f);
        } else {
          moving_.push_back(f);
        }
      }
    }
  }
}

// Wakes what awake or moving bodies meet in this step; true if any did.
bool World::wake_touched(double dt) {
  woken_.clear();
  if (any_asleep()) {
    for (const ContactConstraint& c : contacts_) {
      const bool wakes_a = asleep_[usize(c.a)] != 0 && moves_now(c.b),
                 wakes_b = asleep_[usize(c.b)] != 0 && moves_now(c.a);
      if ((wakes_a || wakes_b) && meets(c, ways_[usize(c.a)], ways_[usize(c.b)]))
        wake(wakes_a ? c.a : c.b);
    }
  }
  for (const Joint& joint : joints_) {
    if (asleep_[usize(joint.a)] != 0 && joint.b >= 0 && moves_now(joint.b)) wake(joint.a);
    if (joint.b >= 0 && asleep_[usize(joint.b)] != 0 && moves_now(joint.a)) wake(joint.b);
  }
  if (!displaced_.empty()) {
    const auto was_displaced = [&](std::int32_t body) {
      return std::find(displaced_.begin(), displaced_.end(), body) != displaced_.end();
    };
    for (const auto* list : {&last_contacts_, &sleeping_contacts_}) {
      for (const ContactConstraint& c : *list) {
        if (was_displaced(c.a)) wake(c.b);
        if (was_displaced(c.b)) wake(c.a);
      }
    }
    for (const auto pairs : {broad_phase_->sleeping_pairs(), broad_phase_->pairs()}) {
      for (const FixturePair& pair : pairs) {
        if (apart(fixtures_.bounds()[usize(pair.a)], fixtures_.bounds()[usize(pair.b)])) continue;
        const std::int32_t a = fixtures_[pair.a].body, b = fixtures_[pair.b].body;
        if (was_displaced(a)) wake(b);
        if (was_displaced(b)) wake(a);
      }
    }
  }
  if (woken_.empty()) return false;
  for (const std::int32_t body : woken_) {
    place_body(body, dt);
    list_fixtures(body);
    active_.push_back(body);
  }
  sort_contacts(last_contacts_);
  return true;
}

// Whether a point of the body has moved too far from where it was when this was last so.
bool World::left_its_place(std::int64_t body) {
  const std::size_t b = usize(body);
  const Quaternion q = bodies_.rotation(body), rest = load_quaternion(&rest_q_[4 * b]);
  const double chord = std::min((q.coeffs() - rest.coeffs()).norm(),  // 2 sin(angle / 4)
                                (q.coeffs() + rest.coeffs()).norm());
  const double gyration =
      std::sqrt(Vec3(&bodies_.inertia[3 * b]).maxCoeff() / bodies_.mass[b]);  // of no fixtures
  const double way = (bodies_.position(body) - Vec3(&rest_x_[3 * b])).norm() +
                     2 * chord * std::max(fixtures_.outer(body), gyration);
  if (way <= options_.sleep.distance) return false;
  std::copy_n(&bodies_.x[3 * b], 3, &rest_x_[3 * b]);
  std::copy_n(&bodies_.q[4 * b], 4, &rest_q_[4 * b]);
  return true;
}

void World::fall_asleep(double dt) {
  if (!options_.sleeping) return;
  speed_.assign(usize(bodies_.size()), 0);
  for (const std::int32_t body : active_)
    if (bodies_.dynamic(body) && left_its_place(body)) speed_[usize(body)] = 1;
  touching_.clear();
  const auto connect = [&](std::int32_t body_a, std::int32_t body_b) {
    const bool a = bodies_.dynamic(body_a), b = bodies_.dynamic(body_b);
    if (a && b) touching_.push_back({body_a, body_b});
    if (!a && moves_now(body_a)) speed_[usize(body_b)] = 1;
    if (!b && moves_now(body_b)) speed_[usize(body_a)] = 1;
  };
  for (const ContactConstraint& c : contacts_)
    if (touches(c)) connect(c.a, c.b);
  for (const Joint& joint : joints_)
    if (joint.b >= 0) connect(joint.a, joint.b);
  islands_.update(dt, {.speed = 0.5, .time = options_.sleep.time}, speed_, touching_);
  for (const std::int32_t body : islands_.slept()) {
    bodies_.set_velocity(body, Vec3::Zero(), Vec3::Zero());
    place_body(body, 0);
    show_sleep(body);
  }
}

// Contacts between bodies of which none is awake rest apart from the others.
void World::sort_contacts(std::vector<ContactConstraint>& contacts) {
  if (!sleep_changed_) return;
  std::vector<const ContactConstraint*> all;
  for (const auto* list : {&contacts, &sleeping_contacts_})
    for (const ContactConstraint& c : *list) all.push_back(&c);
  std::stable_sort(all.begin(), all.end(),
                   [](const auto* c, const auto* d) { return precedes(*c, *d); });
  std::vector<ContactConstraint> awake, asleep;
  for (const ContactConstraint* c : all)
    (is_awake(c->a) || is_awake(c->b) ? awake : asleep).push_back(*c);
  contacts.swap(awake);
  sleeping_contacts_.swap(asleep);
  sleep_changed_ = false;
}

}  // namespace substep::rigid
