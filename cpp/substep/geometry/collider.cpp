#include "substep/geometry/collider.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "substep/core/errors.h"
#include "substep/geometry/closest_points.h"

namespace substep::geometry {
namespace {

// function(shape) for the shape that there is.
template <class Function>
auto visit_shape(const Shape& shape, Function&& function) {
  return std::visit(
      [&]<class S>(const S& s) {
        if constexpr (requires { *s; }) {
          return function(*s);
        } else {
          return function(s);
        }
      },
      shape);
}

}  // namespace

SignedDistance Plane::signed_distance(const Vec3& x) const { return {normal.dot(x), normal}; }

Mat3 Plane::hessian(const Vec3&) const { return Mat3::Zero(); }

SignedDistance Sphere::signed_distance(const Vec3& x) const {
  const double length = x.norm();
  return {length - radius, length > 0 ? Vec3(x / length) : Vec3::UnitZ()};
}

Mat3 Sphere::hessian(const Vec3& x) const {
  const double length = x.norm();
  if (length == 0) return Mat3::Zero();
  const Vec3 n = x / length;
  return (Mat3::Identity() - n * n.transpose()) / length;
}

SignedDistance Box::signed_distance(const Vec3& x) const {
  const Vec3 q = x.cwiseAbs() - half_lengths;
  const Vec3 outward = x.array().sign();
  if (q.maxCoeff() > 0) {
    const Vec3 beyond = q.cwiseMax(0.0);
    const double d = beyond.norm();
    return {d, outward.cwiseProduct(beyond) / d};
  }
  int axis;
  const double d = q.maxCoeff(&axis);
  return {d, x[axis] < 0 ? Vec3(-Vec3::Unit(axis)) : Vec3(Vec3::Unit(axis))};
}

Mat3 Box::hessian(const Vec3& x) const {
  const Vec3 q = x.cwiseAbs() - half_lengths;
  if (q.maxCoeff() <= 0) return Mat3::Zero();
  const auto [d, n] = signed_distance(x);
  const Vec3 active = (q.array() > 0).cast<double>();
  return (Mat3(active.asDiagonal()) - n * n.transpose()) / d;
}

SignedDistance Capsule::signed_distance(const Vec3& x) const {
  const Vec3 arm = x - Vec3(0, 0, std::clamp(x.z(), -half_length, half_length));
  const double length = arm.norm();
  return {length - radius, length > 0 ? Vec3(arm / length) : Vec3::UnitX()};
}

Mat3 Capsule::hessian(const Vec3& x) const {
  const Vec3 arm = x - Vec3(0, 0, std::clamp(x.z(), -half_length, half_length));
  const double length = arm.norm();
  if (length == 0) return Mat3::Zero();
  const Vec3 n = arm / length, free(1, 1, std::abs(x.z()) > half_length ? 1 : 0);
  return (Mat3(free.asDiagonal()) - n * n.transpose()) / length;
}

SignedDistance Cylinder::signed_distance(const Vec3& x) const {
  const Parts at = parts(x);
  if (at.side <= 0 && at.end <= 0) {
    return at.side > at.end ? SignedDistance{at.side, at.e} : SignedDistance{at.end, at.up};
  }
  const double side = std::max(at.side, 0.0), end = std::max(at.end, 0.0);
  const double d = std::hypot(side, end);
  return {d, (side * at.e + end * at.up) / d};
}

Mat3 Cylinder::hessian(const Vec3& x) const {
  const Parts at = parts(x);
  if (at.rho == 0) return Mat3::Zero();
  const Vec3 t(-at.e.y(), at.e.x(), 0);
  const auto [d, n] = signed_distance(x);
  Mat3 h = n.dot(at.e) / at.rho * t * t.transpose();
  if (at.side > 0 && at.end > 0) {
    h += (at.e * at.e.transpose() + at.up * at.up.transpose() - n * n.transpose()) / d;
  }
  return h;
}

Cylinder::Parts Cylinder::parts(const Vec3& x) const {
  const double rho = std::hypot(x.x(), x.y());
  return {rho, rho - radius, std::abs(x.z()) - half_length,
          rho > 0 ? Vec3(x.x() / rho, x.y() / rho, 0) : Vec3::UnitX(),
          Vec3(0, 0, x.z() < 0 ? -1 : 1)};
}

SignedDistance Triangle::signed_distance(const Vec3& x) const {
  const auto w = closest_on_triangle(x, a, b, c);
  const Vec3 arm = x - (w[0] * a + w[1] * b + w[2] * c);
  const double length = arm.norm();
  if (length > 0) return {length - radius, arm / length};
  const Vec3 normal = (b - a).cross(c - a);
  return {-radius, normal.squaredNorm() > 0 ? Vec3(normal.normalized()) : Vec3::UnitZ()};
}

Mat3 Triangle::hessian(const Vec3& x) const {
  const auto w = closest_on_triangle(x, a, b, c);
  const Vec3 arm = x - (w[0] * a + w[1] * b + w[2] * c);
  const double length = arm.norm();
  const auto far = std::count(w.begin(), w.end(), 0.0);  // corners that do not count
  if (length == 0 || far == 0) return Mat3::Zero();
  const Vec3 n = arm / length;
  Mat3 h = Mat3::Identity() - n * n.transpose();
  if (far == 1) {
    const Vec3 edge = (w[0] == 0   ? Vec3(c - b)
                       : w[1] == 0 ? Vec3(c - a)
                                   : Vec3(b - a))
                          .normalized();
    h -= edge * edge.transpose();
  }
  return h / length;
}

Collider::Collider(Shape shape, const Vec3& position, bool hollow)
    : shape_(std::move(shape)), position_(position), sign_(hollow ? -1 : 1) {}

SignedDistance Collider::signed_distance(const Vec3& x) const {
  const SignedDistance d = local_distance(rotation_.transpose() * (x - position_));
  return {d.value, rotation_ * d.gradient};
}

SignedDistance Collider::local_distance(const Vec3& x) const {
  const SignedDistance d = visit_shape(shape_, [&](const auto& s) { return s.signed_distance(x); });
  return {sign_ * d.value, sign_ * d.gradient};
}

Mat3 Collider::hessian(const Vec3& x) const {
  const Vec3 local = rotation_.transpose() * (x - position_);
  const Mat3 h = visit_shape(shape_, [&](const auto& s) { return s.hessian(local); });
  return sign_ * (rotation_ * h * rotation_.transpose());
}

double Collider::lipschitz() const {
  return visit_shape(shape_, [&](const auto& s) { return s.lipschitz(hollow()); });
}

Vec3 Collider::surface_velocity(const Vec3& x) const {
  return velocity + angular_velocity.cross(x - position_);
}

std::shared_ptr<const SampledDistance> sampled(const Shape& shape, int threads) {
  constexpr double kRadius = 24, kLongest = 128, kPad = 3;
  double radius = 0, reach = 0;
  if (const auto* capsule = std::get_if<Capsule>(&shape)) {
    radius = capsule->radius, reach = capsule->half_length + radius;
  } else {
    const Cylinder& cylinder = std::get<Cylinder>(shape);
    radius = cylinder.radius, reach = cylinder.half_length;
  }
  const double h =
      std::max({std::min(radius, reach) / kRadius, 2 * radius / kLongest, 2 * reach / kLongest});
  const auto wide = static_cast<std::int64_t>(std::ceil(radius / h + kPad));
  const auto high = static_cast<std::int64_t>(std::ceil(reach / h + kPad));
  const std::array<std::int64_t, 3> nodes{2 * wide + 1, 2 * wide + 1, 2 * high + 1};
  std::vector<double> values;
  for (std::int64_t i = -wide; i <= wide; ++i)
    for (std::int64_t j = -wide; j <= wide; ++j)
      for (std::int64_t k = -high; k <= high; ++k) {
        const Vec3 x =
            h * Vec3(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k));
        values.push_back(
            visit_shape(shape, [&](const auto& s) { return s.signed_distance(x).value; }));
      }
  const Vec3 origin =
      -h * Vec3(static_cast<double>(wide), static_cast<double>(wide), static_cast<double>(high));
  return std::make_shared<const SampledDistance>(nodes, origin, h, std::move(values), threads);
}

void Collider::set_orientation(const Quaternion& orientation) {
  const double norm = orientation.norm();
  if (!(norm > 0) || !std::isfinite(norm))
    throw InputError("orientation: expected a quaternion that is not zero");
  orientation_ = Quaternion(orientation.coeffs() / norm);
  rotation_ = orientation_.toRotationMatrix();
}

void Collider::advance(double dt) {
  constexpr double kMost = 1e150;  // of what a state may hold: products of two are finite
  const Vec3 to = position_ + dt * velocity;
  const double rate = angular_velocity.norm();
  if (!(to.cwiseAbs().maxCoeff() <= kMost && rate * dt <= kMost)) {
    throw SolverError("an obstacle would be carried beyond 1e150 m, or turned by more radians");
  }
  const Vec6 v = body_velocity();
  const Vec3 centre_to = centre() + dt * v.head<3>();
  if (rate > 0) {
    const Quaternion turn(Eigen::AngleAxisd(rate * dt, angular_velocity / rate));
    set_orientation(turn * orientation_);
  }
  position_ = to;
  if (!yields()) return;
  position_ = centre_to - rotation_ * body.centre;
  set_body_velocity(v);
}

Vec6 Collider::body_velocity() const {
  return joined(surface_velocity(centre()), angular_velocity);
}

void Collider::set_body_velocity(const Vec6& v) {
  angular_velocity = v.tail<3>();
  velocity = v.head<3>() + angular_velocity.cross(position_ - centre());
}

Vec6 Collider::body_impulse() const {
  const Vec3 arm = position_ - centre();
  return joined(exchange_.impulse, exchange_.torque + arm.cross(exchange_.impulse));
}

std::array<double, Collider::kStateSize> Collider::state() const {
  std::array<double, kStateSize> state;
  double* out = state.data();
  const auto put = [&](const Vec3& v) { out = std::copy_n(v.data(), 3, out); };
  put(position_);
  *out++ = orientation_.w();
  put(orientation_.vec());
  put(velocity);
  put(angular_velocity);
  *out++ = friction;
  *out++ = restitution;
  return state;
}

void Collider::restore(const std::array<double, kStateSize>& state) {
  const double* in = state.data();
  const auto take = [&](Vec3& v) {
    v = Vec3(in[0], in[1], in[2]);
    in += 3;
  };
  take(position_);
  orientation_ = Quaternion(in[0], in[1], in[2], in[3]);  // bit by bit: not normalised again
  rotation_ = orientation_.toRotationMatrix();
  in += 4;
  take(velocity);
  take(angular_velocity);
  friction = *in++;
  restitution = *in++;
  exchange_ = total_ = {};
  duration_ = 0;
}

void accelerate_bodies(std::span<Collider> colliders, double dt) {
  for (Collider& collider : colliders) {
    if (!collider.yields()) continue;
    collider.set_body_velocity(collider.body_velocity() + dt * collider.body.acceleration);
  }
}

void push_bodies(std::span<Collider> colliders) {
  for (const std::vector<std::size_t>& body : colliders_by_body(colliders)) {
    Vec6 impulse = Vec6::Zero();
    for (const std::size_t c : body) {
      const Vec6 given = colliders[c].body_impulse();
      colliders[c].body.received += given;
      impulse += given;
    }
    for (const std::size_t c : body) {
      Collider& collider = colliders[c];
      collider.set_body_velocity(collider.body_velocity() + collider.body.mobility * impulse);
    }
  }
}

std::vector<std::vector<std::size_t>> colliders_by_body(std::span<const Collider> colliders) {
  std::map<int, std::vector<std::size_t>> bodies;
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    if (colliders[c].yields()) bodies[colliders[c].body.number].push_back(c);
  }
  std::vector<std::vector<std::size_t>> found;
  for (auto& [number, members] : bodies) found.push_back(std::move(members));
  return found;
}

}  // namespace substep::geometry
