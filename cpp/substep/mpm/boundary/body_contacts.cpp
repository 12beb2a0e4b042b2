#include "substep/mpm/boundary/body_contacts.h"

#include <algorithm>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::mpm {
namespace {

using geometry::Collider;
using geometry::Exchange;
using geometry::Mat3;
using geometry::Mat6;
using geometry::Vec3;
using geometry::Vec6;

// Of a contact, per unit of its mass: j, dj/du and psi.
struct Response {
  Vec3 change = Vec3::Zero();
  Mat3 slope = Mat3::Zero();
  double energy = 0;
};

// [a]_x
Mat3 crossing(const Vec3& a) {
  return (Mat3() << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0).finished();
}

Vec3 surface_velocity(const BodyContact& contact, const Vec6& V) {
  return V.head<3>() + V.tail<3>().cross(contact.arm);
}

bool presses(const BodyContact& contact, double normal) {
  return normal < 0 || contact.boundary == Boundary::kSlip;
}

double friction_bound(const BodyContact& contact, const Vec6& V) {
  const double normal = contact.n.dot(contact.v - surface_velocity(contact, V));
  return contact.friction * std::max(-normal, 0.0);
}

Response respond(const BodyContact& contact, const Vec6& V) {
  const Vec3 relative = contact.v - surface_velocity(contact, V);
  if (contact.boundary == Boundary::kSticky) {
    return {-relative, Mat3::Identity(), 0.5 * relative.squaredNorm()};
  }
  Response r;
  const Vec3& n = contact.n;
  const double normal = relative.dot(n);
  if (presses(contact, normal)) {
    r = {-normal * n, n * n.transpose(), 0.5 * normal * normal};
  }
  if (!(contact.bound > 0)) return r;
  const Vec3 along = relative - normal * n;
  const double speed = along.norm(), bound = contact.bound;
  const Mat3 tangent = Mat3::Identity() - n * n.transpose();
  if (speed <= bound) {
    r.change -= along;
    r.slope += tangent;
    r.energy += 0.5 * speed * speed;
  } else {
    const double share = bound / speed;
    r.change -= share * along;
    r.slope += share * (tangent - along * along.transpose() / (speed * speed));
    r.energy += bound * (speed - 0.5 * bound);
  }
  return r;
}

struct Sums {
  Vec6 impulse = Vec6::Zero();  // sum G^T j
  Mat6 slope = Mat6::Zero();    // H
  double energy = 0;            // sum m |j / m|^2
};

Sums sums(std::span<BodyContact* const> contacts, const Vec6& V) {
  Sums s;
  for (const BodyContact* contact : contacts) {
    const Response r = respond(*contact, V);
    const Vec3 j = contact->mass * r.change;
    const Mat3 A = contact->mass * r.slope, R = crossing(contact->arm), RA = R * A;
    s.impulse.head<3>() += j;
    s.impulse.tail<3>() += contact->arm.cross(j);
    s.slope.topLeftCorner<3, 3>() += A;
    s.slope.topRightCorner<3, 3>() -= A * R;
    s.slope.bottomLeftCorner<3, 3>() += RA;
    s.slope.bottomRightCorner<3, 3>() -= RA * R;
    s.energy += j.dot(r.change);
  }
  return s;
}

// phi
double merit(std::span<BodyContact* const> contacts, const Vec6& V, const Vec6& y, const Vec6& Wy) {
  double sum = 0.5 * y.dot(Wy);
  for (const BodyContact* contact : contacts) {
    sum += contact->mass * respond(*contact, V + Wy).energy;
  }
  return sum;
}

void meet_body(const Vec6& velocity, const Mat6& mobility, std::span<BodyContact* const> contacts) {
  // After so many iterations the bounds of friction stay, with which the rest surely converges.
  constexpr int kBounds = 20, kIterations = 40, kHalvings = 10;
  constexpr double kConverged = 1e-18;  // energy of a correction, of that of all impulses
  constexpr double kLess = 1e-4;        // share of the slope by which phi must fall
  constexpr double kRounding = 1e-13;   // of phi
  Vec6 y = Vec6::Zero(), V = velocity;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    if (iteration < kBounds) {
      for (BodyContact* contact : contacts) contact->bound = friction_bound(*contact, V);
    }
    const Sums now = sums(contacts, V);
    const Mat6 matrix = Mat6::Identity() + now.slope * mobility;
    const Vec6 F = y + now.impulse, dy = matrix.partialPivLu().solve(-F), step = mobility * dy;
    const double left = dy.dot(step);
    const bool converged = !(left > kConverged * (now.energy + y.dot(mobility * y)));
    double part = 1;
    if (!converged) {
      const double before = (1 + kRounding) * merit(contacts, velocity, y, mobility * y);
      for (int k = 0; k < kHalvings; ++k, part /= 2) {
        const Vec6 to = y + part * dy;
        const double most = before + kLess * part * F.dot(step);
        if (merit(contacts, velocity, to, mobility * to) <= most) break;
      }
    }
    y += part * dy;
    V = velocity + mobility * y;
    if (converged) break;
  }
  for (BodyContact* contact : contacts) {
    contact->impulse = contact->mass * respond(*contact, V).change;
  }
}

}  // namespace

void Bodies::begin(const std::vector<Collider>& colliders, double dt) {
  end();
  const auto yields = [](const Collider& collider) { return collider.yields(); };
  if (std::none_of(colliders.begin(), colliders.end(), yields)) return;
  moving_ = colliders;
  masses_.resize(colliders.size());
  for (Collider& collider : moving_) collider.set_exchange({});
  geometry::accelerate_bodies(moving_, dt);
}

void Bodies::end() noexcept {
  moving_.clear();
  masses_.clear();
}

void Bodies::meet(std::span<BodyContact* const> contacts, std::span<const double> near,
                  int threads) {
  const auto bodies = geometry::colliders_by_body(moving_);
  std::vector<std::size_t> body_of(moving_.size());
  std::vector<std::vector<BodyContact*>> of_body(bodies.size());
  for (std::size_t b = 0; b < bodies.size(); ++b) {
    double mass = 0;
    for (const std::size_t c : bodies[b]) body_of[c] = b, mass += near[c];
    for (const std::size_t c : bodies[b]) masses_[c] = mass;
  }
  for (BodyContact* contact : contacts) of_body[body_of[contact->collider]].push_back(contact);
  parallel_chunks(
      static_cast<std::int64_t>(bodies.size()),
      [&](std::int64_t b) {
        if (of_body[usize(b)].empty()) return;
        const Collider& body = moving_[bodies[usize(b)][0]];
        meet_body(body.body_velocity(), body.body.mobility, of_body[usize(b)]);
      },
      threads);
  std::vector<Exchange> given(moving_.size());
  for (const BodyContact* contact : contacts) {
    const Collider& collider = moving_[contact->collider];
    given[contact->collider].add(contact->arm + collider.centre() - collider.position(),
                                 -contact->impulse);
  }
  for (std::size_t c = 0; c < moving_.size(); ++c) moving_[c].set_exchange(given[c]);
  geometry::push_bodies(moving_);
}

void push_body(std::span<Collider> colliders, std::size_t pushed,
               const Exchange& exchange) noexcept {
  Collider& collider = colliders[pushed];
  const Exchange sum = collider.exchange();
  collider.set_exchange(exchange);
  const Vec6 given = collider.body_impulse();
  collider.set_exchange(sum);
  if (given.isZero(0)) return;
  collider.body.received += given;
  for (Collider& other : colliders) {
    if (other.body.number != collider.body.number) continue;
    other.set_body_velocity(other.body_velocity() + other.body.mobility * given);
  }
}

}  // namespace substep::mpm
