#include "substep/springs/bodies.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "substep/core/usize.h"
#include "substep/geometry/bounding_balls.h"

namespace substep::springs {
namespace {

using geometry::Quaternion;

// exp(t + dt) = exp(Jl(t) dt) exp(t) to first order.
Mat3 left_jacobian(const Vec3& t) {
  const double angle = t.norm(), square = angle * angle;
  const bool small = angle < 1e-3;
  const double a = small ? 0.5 - square / 24 : (1 - std::cos(angle)) / square;
  const double b = small ? 1.0 / 6 - square / 120 : (angle - std::sin(angle)) / (square * angle);
  const Mat3 m = cross_matrix(t);
  return Mat3::Identity() + a * m + b * m * m;
}

Quaternion turn_by(const Vec3& t) {
  const double angle = t.norm();
  if (angle == 0.0) return Quaternion::Identity();
  return Quaternion(Eigen::AngleAxisd(angle, t / angle));
}

// B and its pseudoinverse with W = B B^T, one column for each direction that W does not hold.
struct Root {
  Mat6 root, inverse;
};

Root root_of(const Mat6& mobility) {
  constexpr double kHeld = 1e-10;  // of the largest mobility, all scaled to ones on the diagonal
  const Vec6 scale = mobility.diagonal().cwiseMax(0.0).cwiseSqrt();
  const Vec6 inverse = scale.unaryExpr([](double s) { return s > 0.0 ? 1 / s : 0.0; });
  const Eigen::SelfAdjointEigenSolver<Mat6> eigen(inverse.asDiagonal() * mobility *
                                                  inverse.asDiagonal());
  const double least = kHeld * eigen.eigenvalues().maxCoeff();
  const Vec6 values =
      eigen.eigenvalues().unaryExpr([least](double v) { return v > least ? std::sqrt(v) : 0.0; });
  const Vec6 inverses = values.unaryExpr([](double v) { return v > 0.0 ? 1 / v : 0.0; });
  const Mat6& u = eigen.eigenvectors();
  return {scale.asDiagonal() * u * values.asDiagonal(),
          inverses.asDiagonal() * u.transpose() * inverse.asDiagonal()};
}

// How unknowns move the surface of a body at an arm from its centre of mass, in a time h.
Mat36 motion(const Mat6& basis, const Vec3& arm, const Mat3& jacobian, double h) {
  return h * (basis.topRows<3>() - cross_matrix(arm) * jacobian * basis.bottomRows<3>());
}

Eigen::Map<const Vec6> six(const Vec3* unknowns) {
  return Eigen::Map<const Vec6>(unknowns->data());
}

}  // namespace

void Bodies::begin_step(double h, std::span<const double> masses) {
  h_ = h;
  bodies_.clear();
  auto all = geometry::colliders_by_body(contacts_.colliders);
  if (all.empty()) return;
  geometry::accelerate_bodies(contacts_.colliders, h);
  const double mass = masses.empty() ? 1.0
                                     : std::accumulate(masses.begin(), masses.end(), 0.0) /
                                           static_cast<double>(masses.size());
  const auto surfaces = barrier_.surfaces();
  for (auto& colliders : all) {
    const geometry::Collider& first = contacts_.colliders[colliders.front()];
    const Mat6& mobility = first.body.mobility;
    const auto [root, inverse] = root_of(mobility);
    const double lightness = mass * mobility.topLeftCorner<3, 3>().diagonal().maxCoeff();
    const double scale = std::sqrt(mass * std::max(1.0, lightness)) / h;
    Body body;
    body.basis = scale * root;
    body.inertia = scale * scale;
    body.free = first.body_velocity();
    body.start = -inverse * body.free / scale;
    body.coasting = -inverse * (h * first.body.acceleration) / scale;
    body.centre = first.centre();
    for (const std::size_t c : colliders)
      body.turns.push_back(contacts_.colliders[c].orientation());
    for (std::size_t s = 0; s < surfaces.size(); ++s) {
      if (std::ranges::count(colliders, surfaces[s].collider) > 0) body.surfaces.push_back(s);
    }
    body.colliders = std::move(colliders);
    bodies_.push_back(std::move(body));
  }
  place(start());
}

std::vector<Vec3> Bodies::all(Vec6 Body::* unknowns) const {
  std::vector<Vec3> found;
  for (const Body& body : bodies_) {
    const Vec6& its = body.*unknowns;
    found.insert(found.end(), {its.head<3>(), its.tail<3>()});
  }
  return found;
}

Vec6 Bodies::velocity(const Body& body, const Vec3* unknowns) const {
  return body.free + body.basis * six(unknowns);
}

void Bodies::place(Positions unknowns) {
  const Vec3* u = unknowns.data();
  for (Body& body : bodies_) {
    const Vec6 v = velocity(body, u);
    const Vec3 centre = body.centre + h_ * v.head<3>();
    const Quaternion turn = turn_by(h_ * v.tail<3>());
    body.jacobian = left_jacobian(h_ * v.tail<3>());
    for (std::size_t k = 0; k < body.colliders.size(); ++k) {
      geometry::Collider& collider = contacts_.colliders[body.colliders[k]];
      collider.set_orientation(turn * body.turns[k]);
      collider.set_position(centre - collider.rotation() * collider.body.centre);
      collider.set_body_velocity(v);
    }
    u += 2;
  }
}

double Bodies::energy(Positions unknowns) const {
  double sum = 0.0;
  const Vec3* u = unknowns.data();
  for (const Body& body : bodies_) {
    sum += 0.5 * body.inertia * six(u).squaredNorm();
    u += 2;
  }
  return sum;
}

void Bodies::gradient(Positions x, const ContactElements& elements, std::span<Vec3> g) const {
  std::size_t at = usize(contacts_.vertices());
  for (const Body& body : bodies_) {
    const Vec3 centre = contacts_.colliders[body.colliders.front()].centre();
    Vec6 barrier = Vec6::Zero(), friction = Vec6::Zero();
    for (const std::size_t s : body.surfaces) {
      for_pairs(barrier_, friction_, s, [&](std::int32_t i, std::int64_t b, std::int64_t f) {
        if (b >= 0 && !elements.barrier[b].isZero(0.0)) {
          barrier += geometry::wrench(x[i] - centre, elements.barrier[b]);
        }
        if (f >= 0 && !elements.friction[f].isZero(0.0)) {
          friction += geometry::wrench(friction_.arm(f), elements.friction[f]);
        }
      });
    }
    barrier.tail<3>() = body.jacobian.transpose() * barrier.tail<3>();
    const Vec6 sum =
        body.inertia * six(&x[at]) - h_ * (body.basis.transpose() * (barrier + friction));
    g[at++] = sum.head<3>();
    g[at++] = sum.tail<3>();
  }
}

Border Bodies::border(Positions x, const ContactElements& elements, double kept) const {
  Border border{.touches = std::vector<std::vector<Border::Touch>>(bodies_.size()), .corners = {}};
  for (std::size_t b = 0; b < bodies_.size(); ++b) {
    const Body& body = bodies_[b];
    const Vec3 centre = contacts_.colliders[body.colliders.front()].centre();
    const Mat36 go = h_ * body.basis.topRows<3>();
    const Mat36 turn = h_ * body.jacobian * body.basis.bottomRows<3>();
    Mat6 corner = body.inertia * Mat6::Identity();
    const auto add = [&](std::int32_t i, std::int64_t e, std::int64_t f) {
      const Vec3 gradient = e < 0 ? Vec3(Vec3::Zero()) : elements.barrier[e];
      const Mat3 pushing = e < 0 ? Mat3(Mat3::Zero()) : elements.barrier_blocks[e];
      const Mat3 rubbing = f < 0 ? Mat3(Mat3::Zero()) : elements.friction_blocks[f];
      if (gradient.isZero(0.0) && rubbing.isZero(0.0)) return;
      const Vec3 arm = x[i] - centre, rubbed = f < 0 ? Vec3(Vec3::Zero()) : friction_.arm(f);
      const Mat36 near = motion(body.basis, arm, body.jacobian, h_);
      const Mat36 lagged = motion(body.basis, rubbed, Mat3::Identity(), h_);
      const Mat3 lever = gradient * arm.transpose();
      const Mat36 turned = kept * cross_matrix(gradient) * turn;
      border.touches[b].push_back({i, -pushing * near - rubbing * lagged - turned});
      const Mat6 cross = go.transpose() * turned;
      corner += near.transpose() * pushing * near + lagged.transpose() * rubbing * lagged + cross +
                cross.transpose() +
                kept * turn.transpose() *
                    (0.5 * (lever + lever.transpose()) - lever.trace() * Mat3::Identity()) * turn;
    };
    for (const std::size_t s : body.surfaces) for_pairs(barrier_, friction_, s, add);
    border.corners.push_back(corner);
  }
  return border;
}

// As that of a collider that stands (contact.cpp), in the frame of the body: there a vertex that
// goes along r + s dr, dr from the motion of both, goes no faster than |dr| + |h dw| |r + s dr|.
double Bodies::reach(const Body& body, std::size_t s, const Vec3& x, const Vec3& dx, const Vec6& v,
                     const Vec6& dv) const {
  const geometry::Surface& surface = barrier_.surfaces()[s];
  const geometry::Collider& collider = contacts_.colliders[surface.collider];
  const auto member = std::ranges::find(body.colliders, surface.collider);
  const Quaternion& from = body.turns[usize(member - body.colliders.begin())];
  const Vec3 r = x - body.centre - h_ * v.head<3>(), dr = dx - h_ * dv.head<3>();
  const double arm = std::max(r.norm(), (r + dr).norm());
  const double speed =
      geometry::lipschitz(collider, surface.axis) * (dr.norm() + h_ * dv.tail<3>().norm() * arm);
  const auto distance = [&](double t) {
    const Quaternion turn = turn_by(h_ * (v + t * dv).tail<3>()) * from;
    const Vec3 local = turn.conjugate() * (r + t * dr) + collider.body.centre;
    return geometry::local_distance(collider, surface.axis, local).value;
  };
  const double now = geometry::signed_distance(collider, surface.axis, x).value;
  return march(now, speed, distance);
}

// A pair is far, so that reach() does not bound the step, where 0.9 of its distance is more than
// its speed. With a ball of radius R about the collider, o from the centre of the body and a from
// the vertex, e the way of the body and w its turn in the change, and d that of the vertex:
//   0.9 (a - R) > (d + e) (1 + w) + w (a + o).
double Bodies::step_bound(Positions x, Positions dx, Positions unknowns, Positions change) const {
  constexpr double kLargestTurn = 0.45;
  geometry::BoundingBalls balls;
  std::vector<Vec6> v, dv;
  std::vector<std::pair<std::size_t, std::size_t>> all;  // body, surface
  std::size_t at = 0;
  double most = 0.0;  // factor of d
  for (std::size_t b = 0; b < bodies_.size(); ++b) {
    const Body& body = bodies_[b];
    v.push_back(velocity(body, &unknowns[at])), dv.push_back(body.basis * six(&change[at]));
    at += 2;
    const double e = h_ * dv[b].head<3>().norm(), w = h_ * dv[b].tail<3>().norm();
    const double left = 1.0 - kKept - w;
    const bool turns_far = !(w < kLargestTurn);
    if (!turns_far) most = std::max(most, (1.0 + w) / left);
    for (const std::size_t s : body.surfaces) {
      const geometry::Collider& collider = contacts_.colliders[barrier_.surfaces()[s].collider];
      const geometry::BoundingBall ball = geometry::bounding_ball(collider);
      const Vec3 center = collider.position() + collider.rotation() * ball.center;
      const double o = (center - collider.centre()).norm();
      const double radius = (e * (1.0 + w) + w * o + (1.0 - kKept) * ball.radius) / left;
      balls.add(center, turns_far ? std::numeric_limits<double>::infinity() : radius);
      all.emplace_back(b, s);
    }
  }
  std::vector<ContactPair> pairs;  // of `all` and vertices
  std::vector<std::int32_t> close;
  for (std::size_t i = 0; i < contacts_.stiffness.size(); ++i) {
    if (contacts_.stiffness[i] == 0.0) continue;
    balls.find(x[i], most * dx[i].norm(), close);
    for (const std::int32_t k : close) pairs.push_back({k, static_cast<std::int32_t>(i)});
  }
  double bound = 1.0;
  for (const auto& [k, i] : by_surface(pairs, all.size())) {
    const auto [b, s] = all[usize(k)];
    bound *= reach(bodies_[b], s, x[i], bound * dx[i], v[b], bound * dv[b]);
  }
  return bound;
}

void Bodies::push() {
  for (const Body& body : bodies_) {
    for (const std::size_t c : body.colliders) contacts_.colliders[c].set_body_velocity(body.free);
  }
  geometry::push_bodies(contacts_.colliders);
}

}  // namespace substep::springs
