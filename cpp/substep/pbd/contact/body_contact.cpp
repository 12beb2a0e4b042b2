#include "substep/pbd/contact/body_contact.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/usize.h"

namespace substep::pbd {

using geometry::Mat3;
using geometry::Vec3;
using geometry::Vec6;

// A particle and the body behind collider c.
template <class Real>
struct BodyContact<Real>::Pair {
  geometry::ParticleContact<Real>& contact;
  std::size_t c;
  const Point<Real>& start;
  Point<Real>& x;
  double mass, h;

  geometry::Collider& collider() const { return contact.colliders[c]; }
  Vec3 arm() const { return contact.origin() + xyz(x) - collider().centre(); }

  // Of both along the unit vector n.
  double mobility(const Vec3& n) const {
    const Vec6 pull = geometry::wrench(arm(), n);
    return 1 / mass + pull.dot(collider().body.mobility * pull);
  }

  // Moves the particle by d / mass, and the body by the impulse -d / h.
  void move(const Vec3& d) const {
    const Vec3 impulse = -d / h;
    const Vec6 given = geometry::wrench(arm(), impulse);
    contact.add_impulse(c, x, impulse);
    const Vec3 to = xyz(x) + d / mass;
    x.x = static_cast<Real>(to[0]), x.y = static_cast<Real>(to[1]), x.z = static_cast<Real>(to[2]);
    geometry::BodyBehind& body = collider().body;
    body.received += given;
    const Vec6 change = body.mobility * given;
    const Vec3 turn = h * change.tail<3>();
    const double angle = turn.norm();
    const geometry::Quaternion q(Eigen::AngleAxisd(angle, angle > 0 ? Vec3(turn / angle) : turn));
    for (std::size_t k = 0; k < contact.colliders.size(); ++k) {
      geometry::Collider& other = contact.colliders[k];
      if (other.body.number != body.number) continue;
      const Vec3 centre = other.centre() + h * change.head<3>();
      const Vec6 velocity = other.body_velocity() + change;
      if (angle > 0) other.set_orientation(q * other.orientation());
      other.set_position(centre - other.rotation() * other.body.centre);
      other.set_body_velocity(velocity);
      contact.moved(k);
    }
  }
};

template <class Real>
void BodyContact<Real>::begin_substep(geometry::ParticleContact<Real>& contact, double h) {
  h_ = h;
  sums_.clear();
  geometry::accelerate_bodies(contact.colliders, h);
  contact.begin_substep(h);
}

template <class Real>
void BodyContact<Real>::project(geometry::ParticleContact<Real>& contact,
                                std::span<const Point<Real>> start, std::span<Point<Real>> x,
                                std::span<const Real> mass) {
  constexpr int kSweeps = 4;
  if (std::ranges::none_of(contact.colliders, &geometry::Collider::yields)) return;
  find(contact, start, x, mass);
  bool pushed = true;
  for (int sweep = 0; sweep < kSweeps && pushed; ++sweep) {
    pushed = false;
    for (const auto& key : near_) {
      const auto i = usize(key.second);
      const auto m = static_cast<double>(mass[i]);
      const auto known = sums_.find(key);
      Sums sums = known == sums_.end() ? Sums{} : known->second;
      if (!solve({contact, key.first, start[i], x[i], m, h_}, sums)) continue;
      sums_[key] = sums;
      pushed = true;
    }
  }
}

// The pairs that may be too near: within the margin and the ways of all particles and the body.
template <class Real>
void BodyContact<Real>::find(const geometry::ParticleContact<Real>& contact,
                             std::span<const Point<Real>> start, std::span<const Point<Real>> x,
                             std::span<const Real> mass) {
  near_.clear();
  double way = 0, arm = 0, pace = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    way = std::max(way, (xyz(x[i]) - xyz(start[i])).squaredNorm());
    arm = std::max(arm, xyz(x[i]).squaredNorm());
  }
  for (const geometry::Collider& collider : contact.colliders) {
    if (!collider.yields()) continue;
    const Vec6 v = collider.body_velocity();
    const double farthest = std::sqrt(arm) + (collider.centre() - contact.origin()).norm();
    pace = std::max(pace, v.head<3>().norm() + v.tail<3>().norm() * farthest);
  }
  for (const auto& chunk : contact.find_near(x, contact.margin() + std::sqrt(way) + h_ * pace)) {
    for (const auto& [c, i] : chunk) {
      if (mass[usize(i)] != 0 && contact.colliders[usize(c)].yields()) near_.emplace_back(c, i);
    }
  }
  std::sort(near_.begin(), near_.end());
}

// Whether anything had to be moved.
template <class Real>
bool BodyContact<Real>::solve(Pair pair, Sums& sums) const {
  const Vec3 push = pair.contact.way_off(pair.c, pair.start, pair.x);
  const double size = push.norm(), rounding = 2 * std::numeric_limits<Real>::epsilon();
  // What rounds away, or else would be an impulse in every step on what rests.
  if (!(size >
        std::max(1e-9 * pair.contact.margin(), rounding * xyz(pair.x).cwiseAbs().maxCoeff()))) {
    return false;
  }
  const Vec3 n = push / size;
  const double amount = size / pair.mobility(n);
  pair.move(amount * n);
  sums.normal += amount;
  if (pair.collider().friction > 0) rub(pair, n, sums);
  return true;
}

template <class Real>
void BodyContact<Real>::rub(Pair pair, const Vec3& n, Sums& sums) const {
  const Vec3 surface = pair.collider().surface_velocity(pair.contact.origin() + xyz(pair.x));
  const Vec3 way = xyz(pair.x) - xyz(pair.start) - h_ * surface;
  const Vec3 s = way - n.dot(way) * n;
  const double length = s.norm(), bound = pair.collider().friction * sums.normal;
  if (length == 0) return;
  Vec3 wanted = sums.tangential - s / pair.mobility(s / length);
  wanted -= n.dot(wanted) * n;
  if (const double most = wanted.norm(); most > bound) wanted *= bound / most;
  pair.move(wanted - sums.tangential);
  sums.tangential = wanted;
}

template class BodyContact<float>;
template class BodyContact<double>;

}  // namespace substep::pbd
