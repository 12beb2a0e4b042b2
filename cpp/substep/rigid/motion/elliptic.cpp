#include "substep/rigid/motion/elliptic.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace substep::rigid {

Jacobi jacobi(double u, double kc2) {
  constexpr int kLevels = 13;        // agm(1, 1e-300) takes 11
  constexpr double kClose = 2.5e-8;  // the next mean differs by the square of it
  double a[kLevels], b[kLevels];     // Landen's sequence of means
  double mean = 1, kc = std::sqrt(kc2), last;
  int n = 0;
  for (;;) {
    a[n] = mean;
    b[n] = kc;
    last = 0.5 * (mean + kc);
    if (++n == kLevels || std::abs(mean - kc) <= kClose * mean) break;
    kc = std::sqrt(kc * mean);
    mean = last;
  }
  const double K = 0.5 * std::numbers::pi / last;
  const double phase = u * last;
  const double sine = std::sin(phase), cosine = std::cos(phase);
  if (sine == 0) return {sine, cosine, 1, K};
  double t = cosine / sine, c = last * t, dn = 1;
  for (int i = n - 1; i >= 0; --i) {
    t *= c;
    c *= dn;
    dn = (b[i] + t) / (a[i] + t);
    t = c / a[i];
  }
  const double sn = std::copysign(1 / std::sqrt(c * c + 1), sine);
  return {sn, c * sn, dn, K};
}

namespace {

// R_C(1, 1 + e) = atan(sqrt(e)) / sqrt(e), e >= 0.
double rc(double e) {
  if (e > 0.02) {
    const double root = std::sqrt(e);
    return std::atan(root) / root;
  }
  double sum = 0;
  for (int i = 8; i >= 0; --i) sum = 1.0 / (2 * i + 1) - e * sum;
  return sum;
}

}  // namespace

// Carlson 1995, "Numerical computation of real or complex elliptic integrals", Numer. Algorithms
// 10: duplications (algorithm for R_J) until the arguments are close, then the series of
// DLMF 19.36.2, whose error is of the eighth order in their distance.
double carlson_rj(double x, double y, double z, double p) {
  constexpr double kClose = 8e-3;
  const double A0 = (x + y + z + 2 * p) / 5;
  const double dx = A0 - x, dy = A0 - y, dz = A0 - z;
  const double distance = std::max({std::abs(dx), std::abs(dy), std::abs(dz), std::abs(A0 - p)});
  double delta = (p - x) * (p - y) * (p - z);
  double A = A0, quarter = 1, sum = 0;
  while (quarter * distance > kClose * A) {
    const double rx = std::sqrt(x), ry = std::sqrt(y), rz = std::sqrt(z), rp = std::sqrt(p);
    const double lambda = rx * ry + rx * rz + ry * rz;
    const double d = (rp + rx) * (rp + ry) * (rp + rz);
    sum += quarter / d * rc(delta / d / d);
    delta /= 64;
    quarter /= 4;
    A = 0.25 * (A + lambda);
    x = 0.25 * (x + lambda);
    y = 0.25 * (y + lambda);
    z = 0.25 * (z + lambda);
    p = 0.25 * (p + lambda);
  }
  const double X = quarter * dx / A, Y = quarter * dy / A, Z = quarter * dz / A;
  const double P = -0.5 * (X + Y + Z), PP = P * P, XYZ = X * Y * Z;
  const double E2 = X * Y + X * Z + Y * Z - 3 * PP;
  const double E3 = XYZ + 2 * E2 * P + 4 * PP * P;
  const double E4 = (2 * XYZ + E2 * P + 3 * PP * P) * P;
  const double E5 = XYZ * PP;
  const double series = 1 - 3 * E2 / 14 + E3 / 6 + 9 * E2 * E2 / 88 - 3 * E4 / 22 -
                        9 * E2 * E3 / 52 + 3 * E5 / 26 - E2 * E2 * E2 / 16 + 3 * E3 * E3 / 40 +
                        3 * E2 * E4 / 20 + 45 * E2 * E2 * E3 / 272 - 9 * (E3 * E4 + E2 * E5) / 68;
  return quarter * series / (A * std::sqrt(A)) + 6 * sum;
}

}  // namespace substep::rigid
