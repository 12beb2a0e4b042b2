#include "substep/rigid/motion/bodies.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/reserve.h"
#include "substep/core/usize.h"
#include "substep/rigid/shapes/mass_properties.h"

namespace substep::rigid {

namespace {

constexpr std::int64_t kBodiesPerTask = 1024;

Eigen::Map<Vec3> row(std::vector<double>& rows, std::int64_t i) {
  return Eigen::Map<Vec3>(rows.data() + 3 * i);
}
Eigen::Map<const Vec3> row(const std::vector<double>& rows, std::int64_t i) {
  return Eigen::Map<const Vec3>(rows.data() + 3 * i);
}

void append(std::vector<double>& rows, const Vec3& row) {
  rows.insert(rows.end(), row.begin(), row.end());
}

void check_finite(const char* name, const Vec3& v) {
  if (!v.allFinite()) throw InputError(std::string(name) + ": expected finite numbers");
}

// w = R I^-1 R^T L.
Vec3 spin(const Quaternion& q, const Vec3& L, const Vec3& I) {
  return q * (q.conjugate() * L).cwiseQuotient(I);
}

}  // namespace

std::int64_t Bodies::add(const BodyState& body) {
  check_finite("position", body.position);
  check_finite("velocity", body.velocity);
  check_finite("angular_velocity", body.angular_velocity);
  const double largest = body.rotation.coeffs().cwiseAbs().maxCoeff();
  if (!(largest > 0) || !body.rotation.coeffs().allFinite())
    throw InputError("rotation: expected a finite quaternion that is not 0");
  double m = 1;
  Vec3 I = Vec3::Ones();
  if (body.motion == Motion::kDynamic) {
    if (!(body.mass > 0) || !std::isfinite(body.mass))
      throw InputError("mass: expected a finite number above 0, got " + std::to_string(body.mass));
    check_principal_moments(body.inertia, "inertia");
    m = body.mass;
    I = body.inertia;
  } else if (body.motion == Motion::kStatic &&
             (!body.velocity.isZero(0) || !body.angular_velocity.isZero(0))) {
    throw InputError("velocity: a static body has none");
  }
  const Quaternion scaled(body.rotation.coeffs() / largest);
  make_room(1);
  append(x, body.position);
  q.resize(q.size() + 4);
  store_quaternion(scaled.normalized(), &q[q.size() - 4]);
  append(P, Vec3::Zero());
  append(L, Vec3::Zero());
  append(inertia, I);
  append(force, Vec3::Zero());
  append(torque, Vec3::Zero());
  mass.push_back(m);
  motion.push_back(body.motion);
  set_velocity(size() - 1, body.velocity, body.angular_velocity);
  return size() - 1;
}

void Bodies::remove_last() {
  for (auto* rows : {&x, &P, &L, &inertia, &force, &torque}) rows->resize(rows->size() - 3);
  q.resize(q.size() - 4);
  mass.pop_back();
  motion.pop_back();
}

void Bodies::make_room(std::size_t more) {
  for (auto* rows : {&x, &P, &L, &inertia, &force, &torque, &q, &mass})
    reserve_amortised(*rows, rows->size() + 4 * more);
  reserve_amortised(motion, motion.size() + more);
}

std::vector<std::int64_t> Bodies::remove(std::span<const std::int64_t> removed) {
  std::vector<std::int64_t> number(usize(size()), 0);
  for (const std::int64_t i : removed) {
    if (i < 0 || i >= size())
      throw InputError("bodies: expected numbers from 0 to " + std::to_string(size() - 1) +
                       ", got " + std::to_string(i));
    number[usize(i)] = -1;
  }
  std::int64_t next = 0;
  for (std::int64_t& n : number)
    if (n == 0) n = next++;
  const auto compact = [&](auto& rows, std::size_t width) {
    for (std::size_t i = 0; i < number.size(); ++i)
      for (std::size_t k = 0; number[i] >= 0 && k < width; ++k)
        rows[usize(number[i]) * width + k] = rows[i * width + k];
    rows.resize(usize(next) * width);
  };
  for (auto* rows : {&x, &P, &L, &inertia, &force, &torque}) compact(*rows, 3);
  compact(q, 4);
  compact(mass, 1);
  compact(motion, 1);
  return number;
}

Vec3 Bodies::angular_velocity(std::int64_t i) const {
  return spin(rotation(i), row(L, i), row(inertia, i));
}

Mat3 Bodies::inverse_inertia(std::int64_t i) const {
  if (!dynamic(i)) return Mat3::Zero();
  const Mat3 R = rotation(i).toRotationMatrix();
  return R * row(inertia, i).cwiseInverse().asDiagonal() * R.transpose();
}

void Bodies::set_velocity(std::int64_t i, const Vec3& velocity, const Vec3& angular_velocity) {
  set_velocity(i, velocity);
  set_angular_velocity(i, angular_velocity);
}

void Bodies::set_velocity(std::int64_t i, const Vec3& velocity) {
  row(P, i) = mass[usize(i)] * velocity;
}

void Bodies::set_angular_velocity(std::int64_t i, const Vec3& angular_velocity) {
  const Quaternion r = rotation(i);
  row(L, i) = r * (r.conjugate() * angular_velocity).cwiseProduct(row(inertia, i));
}

void Bodies::apply_force(std::int64_t i, const Vec3& F, const Vec3& point) {
  row(force, i) += F;
  row(torque, i) += (point - position(i)).cross(F);
}

void Bodies::apply_impulse(std::int64_t i, const Vec3& J, const Vec3& point) {
  if (!dynamic(i)) return;
  row(P, i) += J;
  row(L, i) += (point - position(i)).cross(J);
}

void Bodies::kick(double dt, const Vec3& gravity, int threads) {
  const DeferInterrupts whole;
  parallel_for(
      size(), kBodiesPerTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          if (!dynamic(i)) continue;
          row(P, i) += dt * (mass[usize(i)] * gravity + row(force, i));
          row(L, i) += dt * row(torque, i);
        }
      },
      threads);
}

void Bodies::clear_forces() {
  std::fill(force.begin(), force.end(), 0);
  std::fill(torque.begin(), torque.end(), 0);
}

std::int64_t Bodies::drift(double dt, FreeRotation method, int threads) {
  const DeferInterrupts whole;
  std::vector<std::int64_t> bad(usize((size() + kBodiesPerTask - 1) / kBodiesPerTask), -1);
  parallel_for(
      size(), kBodiesPerTask,
      [&](std::int64_t begin, std::int64_t end) {
        rotate_rows(method, end - begin, &q[4 * usize(begin)], &L[3 * usize(begin)],
                    &inertia[3 * usize(begin)], dt);
        for (std::int64_t i = begin; i < end; ++i) {
          row(x, i) += dt / mass[usize(i)] * row(P, i);
          // Not finite as soon as one of them is not.
          const double all = position(i).sum() * 0 + rotation(i).coeffs().sum() * 0 +
                             row(P, i).sum() * 0 + row(L, i).sum() * 0;
          if (all != 0 && bad[usize(begin / kBodiesPerTask)] < 0)
            bad[usize(begin / kBodiesPerTask)] = i;
        }
      },
      threads);
  for (const std::int64_t i : bad)
    if (i >= 0) return i;
  return -1;
}

double Bodies::kinetic_energy() const {
  double sum = 0;
  for (std::int64_t i = 0; i < size(); ++i)
    if (dynamic(i)) sum += 0.5 * (velocity(i).dot(row(P, i)) + angular_velocity(i).dot(row(L, i)));
  return sum;
}

double Bodies::potential_energy(const Vec3& gravity) const {
  double sum = 0;
  for (std::int64_t i = 0; i < size(); ++i)
    if (dynamic(i)) sum -= mass[usize(i)] * gravity.dot(position(i));
  return sum;
}

Vec3 Bodies::momentum() const {
  Vec3 sum = Vec3::Zero();
  for (std::int64_t i = 0; i < size(); ++i)
    if (dynamic(i)) sum += row(P, i);
  return sum;
}

Vec3 Bodies::angular_momentum() const {
  Vec3 sum = Vec3::Zero();
  for (std::int64_t i = 0; i < size(); ++i)
    if (dynamic(i)) sum += position(i).cross(row(P, i)) + row(L, i);
  return sum;
}

}  // namespace substep::rigid
