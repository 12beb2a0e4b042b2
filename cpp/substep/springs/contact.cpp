#include "substep/springs/contact.h"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>
#include <utility>

#include "substep/core/usize.h"
#include "substep/geometry/bounding_balls.h"
#include "substep/geometry/conservative_advancement.h"

namespace substep::springs {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Barrier {
  double value, first, second;  // b, b', b''
};

Barrier barrier(double d, double thickness) {
  if (d >= thickness) return {0.0, 0.0, 0.0};
  if (!(d > 0.0)) return {kInfinity, -kInfinity, kInfinity};
  const double gap = d - thickness, logarithm = std::log(d / thickness);
  return {-gap * gap * logarithm, -2.0 * gap * logarithm - gap * gap / d,
          -2.0 * logarithm - 4.0 * gap / d + gap * gap / (d * d)};
}

// The largest s in (0, 1] for which the way from x to x + s dx keeps a tenth of the distance.
double reach(const geometry::Collider& collider, int axis, const Vec3& x, const Vec3& dx) {
  const auto [start, n] = geometry::signed_distance(collider, axis, x);
  if (std::holds_alternative<geometry::Plane>(collider.shape())) {
    const double approach = -n.dot(dx);
    const double spare = (1.0 - kKept) * start;
    return approach > spare ? spare / approach : 1.0;
  }
  return march(start, geometry::lipschitz(collider, axis) * dx.norm(), [&](double s) {
    return geometry::signed_distance(collider, axis, x + s * dx).value;
  });
}

// From the impulses of restitution and friction on a vertex of mass m at x that moves into the
// collider: its velocity relative to it changes by (1 / m + W_x) times these, with the mobility W_x
// of the body's material there.
Vec3 velocity_change(const geometry::Collider& collider, const Vec3& x, const Vec3& n,
                     const Vec3& relative, double mass) {
  const double approach = -n.dot(relative);
  const double push = (1.0 + collider.restitution) * approach;
  if (!collider.yields()) {
    const Vec3 u = relative + approach * n;
    const double y = u.norm();
    const double brake = y > 0.0 ? std::min(collider.friction * push / y, 1.0) : 0.0;
    return push * n - brake * u;
  }
  Eigen::Matrix<double, 3, 6> to_point;
  to_point.leftCols<3>().setIdentity();
  to_point.rightCols<3>() = -cross_matrix(x - collider.centre());
  const Mat3 mobility =
      Mat3::Identity() + mass * to_point * collider.body.mobility * to_point.transpose();
  const double normal = push / n.dot(mobility * n);
  const Vec3 after = relative + normal * mobility * n;
  const Vec3 u = after - n.dot(after) * n;
  const double y2 = u.squaredNorm();
  if (y2 == 0.0) return normal * n;
  const double brake =
      std::min(collider.friction * normal / std::sqrt(y2), y2 / u.dot(mobility * u));
  return normal * n - brake * u;
}

// The velocity of the body behind a collider, of all its colliders, after an impulse at x.
void push_body(std::span<geometry::Collider> colliders, const geometry::Collider& pushed,
               const Vec3& x, const Vec3& impulse) {
  const geometry::Vec6 change =
      pushed.body.mobility * geometry::wrench(x - pushed.centre(), impulse);
  for (geometry::Collider& collider : colliders) {
    if (collider.body.number != pushed.body.number) continue;
    collider.set_body_velocity(collider.body_velocity() + change);
  }
}

}  // namespace

Mat3 cross_matrix(const Vec3& a) {
  Mat3 m;
  m << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
  return m;
}

std::vector<ContactPair> by_surface(std::span<const ContactPair> pairs, std::size_t surfaces) {
  std::vector<std::size_t> next(surfaces + 1, 0);
  for (const ContactPair& pair : pairs) ++next[usize(pair.surface) + 1];
  for (std::size_t s = 0; s < surfaces; ++s) next[s + 1] += next[s];
  std::vector<ContactPair> all(pairs.size());
  for (const ContactPair& pair : pairs) all[next[usize(pair.surface)]++] = pair;
  return all;
}

ContactTerm::ContactTerm(const Contacts& contacts)
    : contacts_(contacts),
      surfaces_(geometry::surfaces(contacts.colliders, true)),
      endless_(std::ranges::none_of(contacts.colliders, [](const geometry::Collider& collider) {
        return std::isfinite(geometry::bounding_ball(collider).radius);
      })) {}

std::int64_t ContactTerm::part_end(std::int64_t e, std::int64_t grain) const {
  const auto part = [&](const ContactPair& pair) {
    return (pair.surface * contacts_.vertices() + pair.vertex) / grain;
  };
  const auto begin = pairs_.begin() + e;
  const auto other = [&, own = part(*begin)](const ContactPair& p) { return part(p) != own; };
  return std::find_if(begin, pairs_.end(), other) - pairs_.begin();
}

std::vector<ContactPair> ContactTerm::pairs_within(Positions x, const auto& reach) const {
  geometry::BoundingBalls balls;
  for (const geometry::Surface& surface : surfaces_) {
    balls.add(contacts_.colliders[surface.collider]);
  }
  std::vector<ContactPair> found;
  std::vector<std::int32_t> close;
  for (std::int32_t i = 0; i < contacts_.vertices(); ++i) {
    if (contacts_.stiffness[usize(i)] == 0.0 && !endless_) continue;
    balls.find(x[i], reach(i), close);
    for (const std::int32_t s : close) found.push_back({s, i});
  }
  return by_surface(found, surfaces_.size());
}

void ContactTerm::set_pairs(std::vector<ContactPair> pairs) {
  if (pairs == pairs_) return;
  std::vector<std::int32_t> vertices;
  for (const ContactPair& pair : pairs) vertices.push_back(pair.vertex);
  pairs_ = std::move(pairs);  // nothing fails from here on
  vertices_ = std::move(vertices);
  ++lists_;
}

void BarrierTerm::find(Positions x) {
  if (endless_ && !pairs_.empty()) return;
  set_pairs(pairs_within(x, [&](std::int32_t) { return contacts_.thickness; }));
}

double BarrierTerm::energy(Positions x, std::int64_t begin, std::int64_t end) const {
  double sum = 0.0;
  for (std::int64_t e = begin; e < end; ++e) {
    const double k = stiffness(e);
    if (k == 0.0) continue;
    const double d = distance(e, x[vertices_[e]]).value;
    if (d < contacts_.thickness) sum += k * barrier(d, contacts_.thickness).value;
  }
  return sum;
}

void BarrierTerm::derivatives(Positions x, std::int64_t begin, std::int64_t end, double kept,
                              Vec3* gradient, Mat3* hessian) const {
  for (std::int64_t e = begin; e < end; ++e) {
    Vec3& g = gradient[e - begin];
    g.setZero();
    if (hessian != nullptr) hessian[e - begin].setZero();
    const double k = stiffness(e);
    if (k == 0.0) continue;
    const Vec3& at = x[vertices_[e]];
    const auto [d, n] = distance(e, at);
    if (d >= contacts_.thickness) continue;
    const Barrier b = barrier(d, contacts_.thickness);
    g = k * b.first * n;
    if (hessian == nullptr) continue;
    Mat3& H = hessian[e - begin];
    const Mat3 curvature = geometry::hessian(collider(e), surface(e).axis, at);
    H = k * b.second * n * n.transpose() + k * b.first * curvature;
    if (kept == 1.0) continue;
    const Eigen::SelfAdjointEigenSolver<Mat3> eigen(H);
    const Vec3 values =
        eigen.eigenvalues().unaryExpr([kept](double l) { return l < 0.0 ? kept * l : l; });
    H = eigen.eigenvectors() * values.asDiagonal() * eigen.eigenvectors().transpose();
  }
}

double BarrierTerm::step_bound(Positions x, Positions dx, std::int64_t, std::int64_t) const {
  const auto way = [&](std::int32_t i) { return dx[i].norm() / (1.0 - kKept); };
  double bound = 1.0;
  for (const auto& [s, i] : pairs_within(x, way)) {
    const geometry::Surface& surface = surfaces_[usize(s)];
    const geometry::Collider& c = contacts_.colliders[surface.collider];
    if (contacts_.stiffness[usize(i)] == 0.0 || c.yields()) continue;
    bound = std::min(bound, reach(c, surface.axis, x[i], bound * dx[i]) * bound);
  }
  return bound;
}

void FrictionTerm::lag(Positions x) {
  std::vector<ContactPair> touching;
  std::vector<Lagged> lagged;
  for (const ContactPair& pair :
       pairs_within(x, [&](std::int32_t) { return contacts_.thickness; })) {
    const geometry::Surface& surface = surfaces_[usize(pair.surface)];
    const geometry::Collider& c = contacts_.colliders[surface.collider];
    const double k = contacts_.stiffness[usize(pair.vertex)];
    if (k == 0.0 || c.friction == 0.0) continue;
    const Vec3& at = x[pair.vertex];
    const auto [d, gradient] = geometry::signed_distance(c, surface.axis, at);
    if (d >= contacts_.thickness || d <= 0.0) continue;
    const double force = -k * barrier(d, contacts_.thickness).first * gradient.norm();
    if (force == 0.0) continue;
    touching.push_back(pair);
    lagged.push_back(
        {c.friction * force, gradient.normalized(), c.surface_velocity(at), at - c.centre()});
  }
  set_pairs(std::move(touching));
  lagged_ = std::move(lagged);
}

// The velocity of the vertex relative to the surface, along it: that of a body that yields is what
// the step finds.
Vec3 FrictionTerm::sliding_velocity(std::int64_t e, Positions v) const {
  const Lagged& contact = lagged_[e];
  const geometry::Collider& c = collider(e);
  const Vec3 relative = v[vertices_[e]] - (c.yields() ? c.surface_velocity(c.centre() + contact.arm)
                                                      : contact.surface_velocity);
  return relative - contact.normal.dot(relative) * contact.normal;
}

// For y < e, y / f1 = e^2 / (2 e - y).
FrictionTerm::Slip FrictionTerm::slip(const Vec3& u) const {
  const double e = contacts_.sticking_speed, y = u.norm();
  const double ratio = y < e ? 2.0 / e - y / (e * e) : 1.0 / y;
  const double slope = y < e ? 1.0 / (e * e * ratio * ratio) : 1.0;
  return {ratio, y > 0.0 ? Vec3(slope / y * u) : Vec3(Vec3::Zero())};
}

void FrictionTerm::arrive(Positions v, std::int64_t begin, std::int64_t end) {
  for (std::int64_t k = begin; k < end; ++k) {
    Lagged& contact = lagged_[usize(k)];
    const Vec3 u = sliding_velocity(k, v);
    if (contact.arrived) {
      const Slip from = slip(contact.u);
      contact.w = from.ratio * (u - from.slope.dot(u - contact.u) * contact.w);
      contact.w /= std::max(1.0, contact.w.norm());
    } else {
      contact.w = slip(u).ratio * u;
      contact.arrived = true;
    }
    contact.u = u;
  }
}

double FrictionTerm::energy(Positions v, std::int64_t begin, std::int64_t end) const {
  const double e = contacts_.sticking_speed;
  double sum = 0.0;
  for (std::int64_t k = begin; k < end; ++k) {
    const Lagged& contact = lagged_[k];
    const double y = sliding_velocity(k, v).norm();
    const double f0 = y < e ? y * y / e - y * y * y / (3.0 * e * e) + e / 3.0 : y;
    sum += contact.bound * f0;
  }
  return sum;
}

void FrictionTerm::derivatives(Positions v, std::int64_t begin, std::int64_t end, double /*kept*/,
                               Vec3* gradient, Mat3* hessian) const {
  for (std::int64_t k = begin; k < end; ++k) {
    const Lagged& contact = lagged_[k];
    const Vec3& n = contact.normal;
    const Vec3 u = sliding_velocity(k, v);
    const auto [ratio, slope] = slip(u);
    gradient[k - begin] = contact.bound * ratio * u;
    if (hessian == nullptr) continue;
    const Vec3 w = contact.arrived ? contact.w : Vec3(ratio * u);
    const Mat3 turned = w * slope.transpose();
    hessian[k - begin] =
        contact.bound * ratio *
        (Mat3::Identity() - n * n.transpose() - 0.5 * (turned + turned.transpose()));
  }
}

void set_exchanges(Contacts& contacts, BarrierTerm& barrier, const FrictionTerm& friction,
                   Positions x, Positions v, double h) {
  constexpr std::int64_t kGrain = 2048;  // vertices, of whose sums that is a sum
  barrier.find(x);
  std::vector<geometry::Exchange> sums(contacts.colliders.size());
  for (std::size_t s = 0; s < barrier.surfaces().size(); ++s) {
    const std::size_t c = barrier.surfaces()[s].collider;
    geometry::Exchange part;
    std::int64_t chunk = 0;
    for_pairs(barrier, friction, s, [&](std::int32_t i, std::int64_t b, std::int64_t f) {
      Vec3 normal = Vec3::Zero(), sliding = Vec3::Zero();
      if (b >= 0) barrier.derivatives(x, b, b + 1, 1.0, &normal, nullptr);
      if (f >= 0) friction.derivatives(v, f, f + 1, 1.0, &sliding, nullptr);
      if (i / kGrain != chunk) sums[c] += std::exchange(part, {});
      chunk = i / kGrain;
      part.add(x[i] - contacts.colliders[c].position(), h * (normal + sliding));
    });
    sums[c] += part;
  }
  for (std::size_t c = 0; c < sums.size(); ++c) contacts.colliders[c].set_exchange(sums[c]);
}

void carry_vertices(const std::vector<geometry::Collider>& before, const Contacts& contacts,
                    std::span<Vec3> x) {
  constexpr double kLeastLeft = 0.5;  // of the distance before
  for (std::size_t c = 0; c < before.size(); ++c) {
    const geometry::Collider &from = before[c], &to = contacts.colliders[c];
    if (from.position() == to.position() &&
        from.orientation().coeffs() == to.orientation().coeffs()) {
      continue;
    }
    const geometry::Quaternion turn = to.orientation() * from.orientation().conjugate();
    const geometry::PlacedBall ball(to);
    for (std::size_t i = 0; i < x.size(); ++i) {
      if (contacts.stiffness[i] == 0.0 || ball.beyond(x[i], contacts.thickness)) continue;
      const auto [d, gradient] = to.signed_distance(x[i]);
      if (!(d < contacts.thickness)) continue;
      const double was = from.signed_distance(x[i]).value;
      if (d > kLeastLeft * was) continue;
      const Vec3 aside = x[i] + (was - d) * gradient.normalized();
      const bool clear = to.signed_distance(aside).value > kLeastLeft * was;
      x[i] = clear ? aside : Vec3(to.position() + turn * (x[i] - from.position()));
    }
  }
}

bool set_off_vertices(const Contacts& contacts, std::span<Vec3> x) {
  constexpr int kRounds = 4;
  bool any = false;
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (contacts.stiffness[i] == 0.0) continue;
    bool inside = true;
    for (int round = 0; inside && round < kRounds; ++round) {
      inside = false;
      for (const geometry::Collider& collider : contacts.colliders) {
        if (collider.signed_distance(x[i]).value > 0.0) continue;
        inside = any = true;
        const Vec3 local = collider.rotation().transpose() * (x[i] - collider.position());
        x[i] +=
            collider.rotation() * (geometry::set_off(collider, local, contacts.thickness) - local);
      }
    }
    if (inside) return false;
  }
  return any;
}

void project_contacts(Contacts& contacts, std::span<const double> masses, std::span<Vec3> x,
                      std::span<Vec3> v) {
  std::vector<geometry::Vec6> free;  // velocities that push_bodies() starts from; none: no bodies
  if (std::ranges::any_of(contacts.colliders, &geometry::Collider::yields)) {
    for (const auto& collider : contacts.colliders) free.push_back(collider.body_velocity());
  }
  for (geometry::Collider& collider : contacts.colliders) {
    geometry::Exchange sum;
    const geometry::PlacedBall ball(collider);
    for (std::size_t i = 0; i < x.size(); ++i) {
      if (contacts.stiffness[i] == 0.0 || ball.beyond(x[i], 0.0)) continue;
      const auto [d, gradient] = collider.signed_distance(x[i]);
      if (d > 0.0) continue;
      const Vec3 n = gradient.normalized();
      x[i] -= d * n;
      const Vec3 relative = v[i] - collider.surface_velocity(x[i]);
      if (n.dot(relative) >= 0.0) continue;
      const Vec3 change = velocity_change(collider, x[i], n, relative, masses[i]);
      v[i] += change;
      sum.add(x[i] - collider.position(), -masses[i] * change);
      if (collider.yields()) push_body(contacts.colliders, collider, x[i], -masses[i] * change);
    }
    collider.set_exchange(sum);
  }
  for (std::size_t c = 0; c < free.size(); ++c) contacts.colliders[c].set_body_velocity(free[c]);
  geometry::push_bodies(contacts.colliders);
}

Closest closest_vertex(const Contacts& contacts, Positions x, double within) {
  geometry::BoundingBalls balls;
  for (const geometry::Collider& collider : contacts.colliders) balls.add(collider);
  std::vector<std::int32_t> near;
  Closest closest{kInfinity, -1, -1};
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (contacts.stiffness[i] == 0.0) continue;
    balls.find(x[i], within, near);
    for (const std::int32_t c : near) {
      const double d = contacts.colliders[usize(c)].signed_distance(x[i]).value;
      // Of those that are as near: of the first collider, the first vertex.
      if (d < closest.distance || (d == closest.distance && c < closest.collider)) {
        closest = {d, static_cast<std::int64_t>(i), c};
      }
    }
  }
  return closest;
}

}  // namespace substep::springs
