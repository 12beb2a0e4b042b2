#include "substep/rigid/motion/free_rotation.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "substep/core/parallel.h"
#include "substep/rigid/motion/elliptic.h"

namespace substep::rigid {

namespace {

// Indices of the least, the middle and the greatest moment.
std::array<int, 3> ascending(const Vec3& I) {
  int low = 0, middle = 1, high = 2;
  if (I[low] > I[middle]) std::swap(low, middle);
  if (I[middle] > I[high]) std::swap(middle, high);
  if (I[low] > I[middle]) std::swap(low, middle);
  return {low, middle, high};
}

// Right-handed axes 1, 2, 3 along the principal ones: m circles axis 3, which it is never opposite
// to; axis 2 has the moment between the others.
struct Axes {
  std::array<int, 3> index;
  std::array<double, 3> sign;
  double excess;  // (L^2 - 2 T I_2) / L^2: above 0 where axis 3 has the greatest moment

  // m: of length 1.
  Axes(const Vec3& m, const Vec3& I) {
    const auto [low, middle, high] = ascending(I);
    excess = m[high] * m[high] * ((I[high] - I[middle]) / I[high]) -
             m[low] * m[low] * ((I[middle] - I[low]) / I[low]);
    index = excess >= 0 ? std::array{low, middle, high} : std::array{high, middle, low};
    const bool even = (index[1] - index[0] + 3) % 3 == 1;
    const double up = m[index[2]] < 0 ? -1 : 1;
    sign = {even ? up : -up, 1, up};
  }
  Vec3 from_body(const Vec3& v) const {
    return {sign[0] * v[index[0]], v[index[1]], sign[2] * v[index[2]]};
  }
  Vec3 to_body(const Vec3& v) const {
    Vec3 r;
    for (std::size_t i = 0; i < 3; ++i) r[index[i]] = sign[i] * v[static_cast<int>(i)];
    return r;
  }
};

// The unit vector at half the angle of (x, y), which has length 1.
std::array<double, 2> half_angle(double x, double y) {
  const double larger = std::sqrt(0.5 * (1 + std::abs(x)));
  const double smaller = 0.5 * std::abs(y) / larger;
  return x >= 0 ? std::array{larger, std::copysign(smaller, y)}
                : std::array{smaller, std::copysign(larger, y)};
}

// f(m) = rot_y(-theta) rot_z(-psi) takes m to e_3 and e_3 into the plane y = 0, where theta is the
// angle between m and e_3 and psi the azimuth of m. The body's own rotation while m goes from m0 to
// m1 and e_3 precesses about L by phi is f(m0)^-1 rot_z(phi) f(m1), here multiplied out.
Quaternion between_frames(const Vec3& m0, const Vec3& m1, double phi) {
  const double rho0 = std::hypot(m0[0], m0[1]), rho1 = std::hypot(m1[0], m1[1]);
  const auto [c0, s0] = half_angle(m0[2], rho0);  // theta0 / 2
  const auto [c1, s1] = half_angle(m1[2], rho1);
  const auto [p0, r0] = half_angle(m0[0] / rho0, m0[1] / rho0);  // psi0 / 2
  const auto [p1, r1] = half_angle(m1[0] / rho1, m1[1] / rho1);
  const double c = std::cos(0.5 * phi), s = std::sin(0.5 * phi);
  const double w = c * (c0 * c1 + s0 * s1), z = s * (c0 * c1 - s0 * s1);
  const double x = s * (s0 * c1 + c0 * s1), y = c * (s0 * c1 - c0 * s1);
  const double c_less = p0 * p1 + r0 * r1, s_less = r0 * p1 - p0 * r1;  // (psi0 - psi1) / 2
  const double c_more = p0 * p1 - r0 * r1, s_more = r0 * p1 + p0 * r1;  // (psi0 + psi1) / 2
  return {c_less * w - s_less * z, c_more * x - s_more * y, s_more * x + c_more * y,
          s_less * w + c_less * z};
}

// m = (A1 cn u, A2 sn u, A3 dn u) of length 1 with u' = +- lambda, + where axis 3 has the greatest
// moment. L: the length of the angular momentum.
Quaternion circling_rotation(const Vec3& m, const Vec3& I, double excess, double L, double dt) {
  const double I12 = I[1] - I[0], I13 = I[2] - I[0], I23 = I[2] - I[1];  // all of one sign or 0
  const double kappa = I13 / I23 * (I[1] / I[0]);                        // (A2 / A1)^2 >= 1
  const double A1 = std::sqrt(m[0] * m[0] + m[1] * m[1] / kappa);
  const double A2 = std::sqrt(kappa) * A1;
  const double flat = I12 / I13 * (I[2] / I[1]);
  const double A3 = std::sqrt(m[2] * m[2] + m[1] * m[1] * flat);
  // k^2 = flat (A2 / A3)^2. Rounding of m moves 1 - k^2 by more than this floor, which keeps the
  // quarter period finite on the separatrix.
  const double kc2 = std::clamp(excess / (A3 * A3) * (I[2] / I23), 1e-32, 1.0);
  const double lambda = L / I[2] * A3 * std::sqrt(I13 / I[0] * (I23 / I[1]));

  const double v = std::copysign(lambda, I13) * dt;
  Jacobi e = jacobi(v, kc2);
  const double periods = std::nearbyint(0.5 * v / e.K);
  if (std::fmod(periods, 2) != 0) e.sn = -e.sn, e.cn = -e.cn;
  const double S = e.sn, C = e.cn, D = e.dn;  // at the rest w of v, |w| <= K

  // Addition theorem (DLMF 22.8.1-3) from u to u + w.
  const double s = m[1] / A2, c = m[0] / A1, d = m[2] / A3;
  const double below = 1 / (c * c + s * s * D * D);  // 1 - k^2 s^2 S^2, nothing cancels
  const double s1 = (s * C * D + S * c * d) * below;
  const double c1 = (c * C - s * S * d * D) * below;
  const double d1 = (d * D - (1 - kc2) * s * c * S * C) * below;

  // phi' = L (m1^2 / I1 + m2^2 / I2) / (m1^2 + m2^2) = L / I1 - L (1 / I1 - 1 / I2) g(u),
  // g = kappa sn^2 / (1 + (kappa - 1) sn^2). Its integral G is of the third kind (DLMF 19.25.14),
  // with the addition theorem DLMF 19.11.1-4, where L (1 / I1 - 1 / I2) / u' = ratio and
  // ratio kappa / sqrt(delta) = 1: its arc tangent is an angle as it is.
  const double ratio = std::abs(I12) / A3 * (I[2] / I[0]) / std::sqrt(I[1] / I[0] * I13 * I23);
  const auto G = [&](double sn, double cn, double dn) {
    const double p = 1 + (kappa - 1) * sn * sn;
    return kappa / 3 * (sn * sn * sn) * carlson_rj(cn * cn, dn * dn, 1, p);
  };
  double third = G(S, C, D);
  if (periods != 0) third += 2 * periods * G(1, 0, std::sqrt(kc2));
  const double turn =
      std::atan2(ratio * kappa * s * S * s1, 1 + (kappa - 1) * (s1 * s1 - s * S * c1 * d1));
  const double phi = L / I[0] * dt - ratio * third - turn;

  const double back = std::fmod(periods, 2) != 0 ? -1 : 1;
  const Vec3 m1 = Vec3(back * A1 * c1, back * A2 * s1, A3 * d1).normalized();
  return between_frames(m, m1, phi);
}

}  // namespace

Quaternion exact_rotation(const Quaternion& q, const Vec3& L, const Vec3& inertia, double dt) {
  const double largest = L.cwiseAbs().maxCoeff();  // or squares would underflow or overflow
  if (largest == 0 || dt == 0) return q;
  const Vec3 direction = (L / largest).normalized();
  const double length = largest * (L / largest).norm();
  const Vec3 m = (q.conjugate() * direction).normalized();
  const Vec3 rate = inertia.cwiseInverse();
  const Vec3 w = m.cwiseProduct(rate);
  const Vec3 torque(m[1] * m[2] * (rate[2] - rate[1]), m[2] * m[0] * (rate[0] - rate[2]),
                    m[0] * m[1] * (rate[1] - rate[0]));
  Quaternion own;  // rotation in the body frame
  // Along a principal axis (or in a plane of equal ones) the body turns at one rate.
  if (torque.lpNorm<Eigen::Infinity>() <= 1e-30 * w.lpNorm<Eigen::Infinity>()) {
    own = rotation_by(length * dt * w);
  } else {
    const Axes axes(m, inertia);
    own = circling_rotation(axes.from_body(m), axes.from_body(inertia).cwiseAbs(), axes.excess,
                            length, dt);
    own.vec() = axes.to_body(own.vec());
  }
  Quaternion next = (q * own).normalized();
  if (next.dot(q) < 0) next.coeffs() = -next.coeffs();  // the nearer of the two signs
  return next;
}

Quaternion quaternion_rotation(const Quaternion& q, const Vec3& L, const Vec3& inertia, double dt) {
  const Vec3 w = q * (q.conjugate() * L).cwiseQuotient(inertia);
  const Quaternion rate = Quaternion(0, w[0], w[1], w[2]) * q;
  return Quaternion(q.coeffs() + 0.5 * dt * rate.coeffs()).normalized();
}

Mat3 matrix_rotation(const Mat3& R, const Vec3& L, const Vec3& inertia, double dt) {
  const Vec3 w = R * (R.transpose() * L).cwiseQuotient(inertia);
  Mat3 next;
  for (int j = 0; j < 3; ++j) next.col(j) = R.col(j) + dt * w.cross(R.col(j));
  next.col(0).normalize();
  next.col(1) = (next.col(1) - next.col(0).dot(next.col(1)) * next.col(0)).normalized();
  next.col(2) = next.col(0).cross(next.col(1));
  return next;
}

void rotate_rows(FreeRotation method, std::int64_t n, double* q, const double* L,
                 const double* inertia, double dt) {
  const auto each = [&](auto&& rotate) {
    for (std::int64_t i = 0; i < n; ++i) {
      const Eigen::Map<const Vec3> momentum(L + 3 * i), moments(inertia + 3 * i);
      store_quaternion(rotate(load_quaternion(q + 4 * i), momentum, moments, dt), q + 4 * i);
    }
  };
  switch (method) {
    case FreeRotation::kExact:
      return each(exact_rotation);
    case FreeRotation::kSplitting:
      return splitting_rows(n, q, L, inertia, dt);
    case FreeRotation::kQuaternion:
      return each(quaternion_rotation);
    case FreeRotation::kMatrix:
      return each([](const Quaternion& q0, const Vec3& L0, const Vec3& I, double h) {
        return Quaternion(matrix_rotation(q0.toRotationMatrix(), L0, I, h)).normalized();
      });
  }
}

void rotate_freely(FreeRotation method, std::int64_t n, double* q, const double* L,
                   const double* inertia, double dt, std::int64_t steps, int threads) {
  for (std::int64_t step = 0; step < steps; ++step)
    parallel_for(
        n, 1024,
        [&](std::int64_t begin, std::int64_t end) {
          rotate_rows(method, end - begin, q + 4 * begin, L + 3 * begin, inertia + 3 * begin, dt);
        },
        threads);
}

}  // namespace substep::rigid
