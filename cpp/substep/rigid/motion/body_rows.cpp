#include "substep/rigid/motion/body_rows.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "substep/core/parallel.h"
#include "substep/core/point_lanes.h"
#include "substep/core/usize.h"
#include "substep/rigid/motion/row_vectors.h"

namespace substep::rigid {
namespace {

constexpr std::int64_t kRowsPerTask = 256;
constexpr double kFarTurned = 0.5;  // [rad]
constexpr double kMostGain = 1.02;  // of the energy of rotation

Point<double> to_row(const Vec3& v, double w = 0) { return {v.x(), v.y(), v.z(), w}; }

// A row in registers, in one vector or two. It is read and written at once, as those that read and
// write it in lanes do (body_lanes.h): a load waits long for stores of which each has only a part.
template <class Part>
class RowOf {
 public:
  explicit RowOf(const BodyRow& row) { std::memcpy(part_, &row, sizeof row); }
  void store(BodyRow& row) const { std::memcpy(&row, part_, sizeof row); }

  friend RowOf operator+(const RowOf& x, const RowOf& y) {
    return of([&](int k) { return x.part_[k] + y.part_[k]; });
  }
  friend RowOf operator-(const RowOf& x, const RowOf& y) {
    return of([&](int k) { return x.part_[k] - y.part_[k]; });
  }
  friend RowOf operator*(double s, const RowOf& x) {
    return of([&](int k) { return s * x.part_[k]; });
  }
  Quad<double> linear() const {
    if constexpr (kParts == 2)
      return part_[0];
    else
      return __builtin_shufflevector(part_[0], part_[0], 0, 1, 2, 3);
  }
  Quad<double> angular() const {
    if constexpr (kParts == 2)
      return part_[1];
    else
      return __builtin_shufflevector(part_[0], part_[0], 4, 5, 6, 7);
  }

 private:
  static constexpr int kParts = sizeof(BodyRow) / sizeof(Part);

  RowOf() = default;
  template <class F>
  static RowOf of(const F& part) {
    RowOf result;
    for (int k = 0; k < kParts; ++k) result.part_[k] = part(k);
    return result;
  }

  Part part_[kParts];
};
using RowLanes = RowOf<Vector<double, std::max(kVectorBytes, 32)>>;

// R D R^T.
Mat3 conjugated(const Mat3& R, const Vec3& D) { return R * D.asDiagonal() * R.transpose(); }

}  // namespace

Mat3 BodyRows::root_of(std::int32_t row) const {
  const auto& [d, m] = root[usize(row)];
  Mat3 W;
  W << d.x, m.x, m.y, m.x, d.y, m.z, m.y, m.z, d.z;
  return W;
}

void BodyRows::load(const Bodies& bodies, const Vec3& gravity, std::span<const std::uint8_t> asleep,
                    int threads) {
  row_of.assign(usize(bodies.size()), 0);
  body_of.assign(1, -1);
  for (std::int64_t i = 0; i < bodies.size(); ++i) {
    if (bodies.motion[usize(i)] == Motion::kStatic || (!asleep.empty() && asleep[usize(i)] != 0))
      continue;
    row_of[usize(i)] = static_cast<std::int32_t>(body_of.size());
    body_of.push_back(static_cast<std::int32_t>(i));
  }
  for (Rows* rows : {&velocity, &free, &push, &acceleration, &displacement, &root}) {
    rows->reset(body_of.size());
    (*rows)[0] = {};
  }
  stands.assign(body_of.size(), 0);
  stands[0] = 1;
  turns.assign(body_of.size(), 0);
  led.assign(body_of.size(), 0);
  turned_.reset(4 * body_of.size());
  first_spin_.reset(3 * body_of.size());
  Vec3::Map(first_spin_.data()).setZero();
  parallel_for(
      size() - 1, kRowsPerTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t row = begin + 1; row <= end; ++row) {
          const std::size_t k = usize(row), i = usize(body_of[k]);
          const bool dynamic = bodies.dynamic(body_of[k]);
          const double inverse_root = 1 / std::sqrt(bodies.mass[i]);
          const Mat3 W = conjugated(bodies.rotation(body_of[k]).toRotationMatrix(),
                                    Vec3(&bodies.inertia[3 * i]).cwiseSqrt().cwiseInverse());
          root[k] = {to_row(W.diagonal(), inverse_root),
                     {W(0, 1), W(0, 2), W(1, 2), dynamic ? 1. : 0.}};
          const Vec3 spin = W * Vec3(&bodies.L[3 * i]);
          velocity[k] = free[k] = {to_row(Vec3(&bodies.P[3 * i]) * inverse_root), to_row(spin)};
          Vec3::Map(&first_spin_[3 * k]) = spin;
          std::copy_n(&bodies.q[4 * i], 4, &turned_[4 * k]);
          acceleration[k] = push[k] = displacement[k] = {};
          if (!dynamic) continue;
          const Vec3 force = bodies.mass[i] * gravity + Vec3(&bodies.force[3 * i]);
          acceleration[k] = {to_row(force * inverse_root), to_row(W * Vec3(&bodies.torque[3 * i]))};
        }
      },
      threads);
}

void BodyRows::accelerate(std::int64_t begin, std::int64_t end, double h, double slow,
                          double lost) {
  const auto settled = [&](std::size_t i, const RowLanes& v) {
    const auto square = v.linear() * v.linear() + v.angular() * v.angular();
    const double energy = (square[0] + square[1] + square[2]) * root[i].linear.w * root[i].linear.w;
    return energy < slow * slow ? (1 - lost * (1 - energy / (slow * slow))) * v : v;
  };
  for (auto i = usize(begin); i < usize(end); ++i) {
    if (led[i] != 0) continue;
    const RowLanes v(velocity[i]);
    const RowLanes unpushed = (stands[i] != 0 ? settled(i, v) : v) + h * RowLanes(acceleration[i]);
    unpushed.store(free[i]);
    (unpushed + RowLanes(push[i])).store(velocity[i]);
  }
}

void BodyRows::move(std::int64_t begin, std::int64_t end, double h) {
  // A push below a millionth of what its acceleration gives is none.
  const auto none = [h](const auto& p, const auto& a) {
    const auto pp = p * p, aa = a * a;
    return pp[0] + pp[1] + pp[2] <= 1e-12 * h * h * (aa[0] + aa[1] + aa[2]);
  };
  for (auto i = usize(begin); i < usize(end); ++i) {
    if (led[i] != 0) continue;
    const RowLanes v(velocity[i]), a(acceleration[i]), kick = v - RowLanes(free[i]);
    const bool falls = none(kick.linear(), a.linear()) && none(kick.angular(), a.angular());
    const double parabola = falls ? 0.5 * h * h : 0;
    kick.store(push[i]);
    (RowLanes(displacement[i]) + (h * v - parabola * a)).store(displacement[i]);
  }
}

Vec3 BodyRows::spin_row(std::int32_t row) const { return from_row(velocity[usize(row)].angular); }
Vec3 BodyRows::velocity_of(std::int32_t row) const {
  return scale_of(row) * from_row(velocity[usize(row)].linear);
}
Vec3 BodyRows::spin_of(std::int32_t row) const { return root_of(row) * spin_row(row); }

Quaternion BodyRows::rotation(const Bodies& bodies, std::int32_t body) const {
  const std::int32_t r = row(body);
  if (turns[usize(r)] != 0) return load_quaternion(&turned_[4 * usize(r)]);
  return rotation_by(root_of(r) * from_row(displacement[usize(r)].angular)) * bodies.rotation(body);
}

Pose BodyRows::pose(const Bodies& bodies, std::int32_t body) const {
  const std::int32_t r = row(body);
  if (r == 0) return bodies.pose(body);
  return {bodies.position(body) + scale_of(r) * from_row(displacement[usize(r)].linear),
          rotation(bodies, body)};
}

Pose BodyRows::pose_after(const Bodies& bodies, std::int32_t body, const Pose& now, double h,
                          Vec3& spin) const {
  const std::int32_t r = row(body);
  spin = spin_of(r);
  if (r == 0) return now;
  const Pose then(now.position + h * velocity_of(r),
                  Mat3(rotation_by(h * spin).toRotationMatrix() * now.rotation));
  if (turns[usize(r)] != 0) {
    const Vec3 inertia(&bodies.inertia[3 * usize(body)]);
    spin = then.rotation * (then.rotation.transpose() * momentum_of(r)).cwiseQuotient(inertia);
  }
  return then;
}

void BodyRows::turn(const Bodies& bodies, std::int32_t r, double h, FreeRotation method) {
  const std::size_t k = usize(r), i = usize(body_of[k]);
  const Mat3 W = root_of(r);
  const Vec3 L = momentum_of(r), torque = W.inverse() * from_row(acceleration[k].angular);
  const Vec3 aside = from_row(displacement[k].angular) - h * spin_row(r);
  double* const q = &turned_[4 * k];
  rotate_rows(method, 1, q, L.data(), &bodies.inertia[3 * i], h);
  if (!aside.isZero(0))
    store_quaternion((rotation_by(W * aside) * load_quaternion(q)).normalized(), q);
  const Mat3 next = conjugated(load_quaternion(q).toRotationMatrix(),
                               Vec3(&bodies.inertia[3 * i]).cwiseSqrt().cwiseInverse());
  root[k].linear = to_row(next.diagonal(), root[k].linear.w);
  root[k].angular = {next(0, 1), next(0, 2), next(1, 2), root[k].angular.w};
  velocity[k].angular = to_row(next * L);
  acceleration[k].angular = to_row(next * torque);
  displacement[k].angular = {};
  push[k] = {};
}

std::int64_t BodyRows::first_not_finite(const Bodies& bodies) const {
  // Of squares: the sum of those of the state, with those of forces, is finite.
  constexpr double kMost = 0.25 * std::numeric_limits<double>::max();
  for (std::size_t k = 1; k < body_of.size(); ++k) {
    const auto square = [](const Point<double>& p) { return from_row(p).squaredNorm(); };
    const double sum = square(velocity[k].linear) + square(velocity[k].angular) +
                       square(displacement[k].linear) + square(displacement[k].angular) +
                       velocity_of(static_cast<std::int32_t>(k)).squaredNorm() +
                       bodies.position(body_of[k]).squaredNorm();
    if (!(sum < kMost)) return body_of[k];
  }
  return -1;
}

bool BodyRows::turns_anew(std::int64_t row, double dt) const {
  const std::size_t k = usize(row);
  const Vec3 spin = from_row(velocity[k].angular) - Vec3(&first_spin_[3 * k]);
  const double trace = root[k].linear.x + root[k].linear.y + root[k].linear.z;  // of W^(1/2)
  return trace * spin.norm() * dt > kFarTurned &&
         (root_of(static_cast<std::int32_t>(row)) * spin).norm() * dt > kFarTurned;
}

std::int64_t BodyRows::store(Bodies& bodies, double dt, FreeRotation method, int threads) const {
  if (const std::int64_t bad = first_not_finite(bodies); bad >= 0) return bad;
  parallel_for(
      size() - 1, kRowsPerTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t row = begin + 1; row <= end;) {  // runs of bodies without a gap
          const std::size_t body = usize(body_of[usize(row)]);
          std::int64_t n = 1;
          if (turns[usize(row)] != 0) {
            ++row;
            continue;
          }
          if (turns_anew(row, dt)) {
            Vec3::Map(&bodies.L[3 * body]) = root_of(static_cast<std::int32_t>(row)).inverse() *
                                             from_row(velocity[usize(row)].angular);
          } else {
            while (row + n <= end && body_of[usize(row + n)] == body_of[usize(row)] + n &&
                   turns[usize(row + n)] == 0 && !turns_anew(row + n, dt))
              ++n;
          }
          rotate_rows(method, n, &bodies.q[4 * body], &bodies.L[3 * body],
                      &bodies.inertia[3 * body], dt);
          row += n;
        }
        for (std::int64_t row = begin + 1; row <= end; ++row) {
          const std::size_t k = usize(row), i = usize(body_of[k]);
          const BodyRow &x = displacement[k], &v = velocity[k];
          const double scale = root[k].linear.w;
          Vec3::Map(&bodies.x[3 * i]) += from_row(x.linear) * scale;
          if (turns[k] != 0) std::copy_n(&turned_[4 * k], 4, &bodies.q[4 * i]);
          if (!bodies.dynamic(body_of[k])) continue;
          const Mat3 W = root_of(static_cast<std::int32_t>(row));
          const Vec3 first(&first_spin_[3 * k]);
          const Vec3 turn = from_row(x.angular) - dt * first, spin = from_row(v.angular) - first;
          Vec3::Map(&bodies.P[3 * i]) = from_row(v.linear) / scale;
          if (turns[k] != 0) {
            Vec3::Map(&bodies.L[3 * i]) = momentum_of(static_cast<std::int32_t>(row));
            continue;
          }
          if (turns_anew(row, dt)) continue;
          if (!turn.isZero(0)) {
            store_quaternion((rotation_by(W * turn) * bodies.rotation(body_of[k])).normalized(),
                             &bodies.q[4 * i]);
          }
          if (spin.isZero(0)) continue;
          // L of what has turned by then has another energy than v, that which contacts left it.
          Eigen::Map<Vec3> L(&bodies.L[3 * i]);
          L += W.inverse() * spin;
          const Vec3 in_body = bodies.rotation(body_of[k]).conjugate() * L;
          const double energy =
              in_body.cwiseAbs2().dot(Vec3(&bodies.inertia[3 * i]).cwiseInverse());
          const double left = from_row(v.angular).squaredNorm();
          if (energy > kMostGain * left) L *= std::sqrt(left / energy);
        }
      },
      threads);
  return -1;
}

}  // namespace substep::rigid
