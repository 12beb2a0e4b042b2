#include "substep/geometry/collider.h"

#include <algorithm>

#include "substep/core/errors.h"

namespace substep::geometry {

Collider::Collider(Shape shape, const Vec3& position, bool hollow)
    : shape_(std::move(shape)), position_(position), sign_(hollow ? -1 : 1) {}

std::shared_ptr<const SampledDistance> sampled(const Shape& shape, int threads) {
  constexpr double kRadius = 24, kLongest = 128, kPad = 3;
  double radius = 0, reach = 0;
  if (const auto* capsule = std::get_if<Capsule>(&shape)) {
    radius = capsule->radius, reach = capsule->half_length + radius;
  } else {
    const Cylinder& cylinder = std::get<Cylinder>(shape);
    radius = cylinder.radius, reach = cylinder.half_length;
  }
  const double h = std::max({std::min(radius, reach) / kRadius, 2 * radius / kLongest,
                             2 * reach / kLongest});
  const auto wide = static_cast<std::int64_t>(std::ceil(radius / h + kPad));
  const auto high = static_cast<std::int64_t>(std::ceil(reach / h + kPad));
  const std::array<std::int64_t, 3> nodes{2 * wide + 1, 2 * wide + 1, 2 * high + 1};
  std::vector<double> values;
  for (std::int64_t i = -wide; i <= wide; ++i)
    for (std::int64_t j = -wide; j <= wide; ++j)
      for (std::int64_t k = -high; k <= high; ++k) {
        const Vec3 x = h * Vec3(static_cast<double>(i), static_cast<double>(j),
                                static_cast<double>(k));
        values.push_back(
            visit_shape(shape, [&](const auto& s) { return s.signed_distance(x).value; }));
      }
  const Vec3 origin = -h * Vec3(static_cast<double>(wide), static_cast<double>(wide),
                                static_cast<double>(high));
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
  total_ = {};
  duration_ = 0;
}

}  // namespace substep::geometry
