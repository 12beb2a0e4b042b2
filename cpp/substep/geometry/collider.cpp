#include "substep/geometry/collider.h"

#include <algorithm>

#include "substep/core/errors.h"

namespace substep::geometry {

Collider::Collider(Shape shape, const Vec3& position, bool hollow)
    : shape_(std::move(shape)), position_(position), sign_(hollow ? -1 : 1) {}

void Collider::set_orientation(const Quaternion& orientation) {
  const double norm = orientation.norm();
  if (!(norm > 0) || !std::isfinite(norm))
    throw InputError("orientation: expected a quaternion that is not zero");
  orientation_ = Quaternion(orientation.coeffs() / norm);
  rotation_ = orientation_.toRotationMatrix();
}

void Collider::advance(double dt) {
  position_ += dt * velocity;
  const double rate = angular_velocity.norm();
  if (rate == 0) return;
  const Quaternion turn(Eigen::AngleAxisd(rate * dt, angular_velocity / rate));
  set_orientation(turn * orientation_);
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
  put(exchange_.impulse);
  put(exchange_.torque);
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
  take(exchange_.impulse);
  take(exchange_.torque);
}

}  // namespace substep::geometry
