// Rotations by unit quaternions: what Eigen's type lacks. Arrays hold them as (w, x, y, z).
//
// q rotates vectors of the body into the world: x = q * X; q * p rotates by p first. Eigen has the
// products, toRotationMatrix() and the constructor from a matrix.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

namespace substep {

// Of an array row: its order is (w, x, y, z), Eigen's own is not.
inline Eigen::Quaterniond load_quaternion(const double* wxyz) {
  return {wxyz[0], wxyz[1], wxyz[2], wxyz[3]};
}
inline void store_quaternion(const Eigen::Quaterniond& q, double* wxyz) {
  wxyz[0] = q.w(), wxyz[1] = q.x(), wxyz[2] = q.y(), wxyz[3] = q.z();
}

// The exponential: the rotation by |a| [rad] about a.
inline Eigen::Quaterniond rotation_by(const Eigen::Vector3d& a) {
  const double angle = a.norm();
  const double half = 0.5 * angle;
  const double scale = angle > 1e-4 ? std::sin(half) / angle : 0.5 - angle * angle / 48;
  const Eigen::Vector3d v = scale * a;
  return {std::cos(half), v[0], v[1], v[2]};
}

// The logarithm: a with rotation_by(a) = q or -q and |a| <= pi.
inline Eigen::Vector3d rotation_vector(const Eigen::Quaterniond& q) {
  const double sine = q.vec().norm();
  const double half = std::atan2(sine, std::abs(q.w()));
  return (std::copysign(sine > 1e-4 ? 2 * half / sine : 2 + sine * sine / 3, q.w())) * q.vec();
}

}  // namespace substep
