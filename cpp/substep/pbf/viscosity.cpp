#include "substep/pbf/viscosity.h"

#include <algorithm>
#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/pbf/sums.h"

namespace substep::pbf {
namespace {

template <class Real>
double dot(const Point<Real>& a, const Point<Real>& b) {
  return double(a.x) * double(b.x) + double(a.y) * double(b.y) + double(a.z) * double(b.z);
}

// a + s b, keeping a.w.
template <class Real>
Point<Real> add_scaled(const Point<Real>& a, Real s, const Point<Real>& b) {
  return {a.x + s * b.x, a.y + s * b.y, a.z + s * b.z, a.w};
}

// G without its scale.
template <class V>
SUBSTEP_INLINE V weight(const V& q) {
  const V a = positive_part<V>(1 - q);
  return a + a * a;
}

}  // namespace

// d / sum_j G(r_j) (r_j / h)^2 over the lattice of volumes V.
template <class Real>
double Viscosity<Real>::weight_scale(const Neighbourhood<Real>& near) {
  const int d = near.dimension;
  const double spacing = std::pow(double(near.volume), 1.0 / d), h = double(near.h) / spacing;
  const int m = static_cast<int>(h), m_z = d == 2 ? 0 : m;
  double sum = 0;
  for (int a = -m; a <= m; ++a) {
    for (int b = -m; b <= m; ++b) {
      for (int c = -m_z; c <= m_z; ++c) {
        const double q = std::sqrt(double(a * a + b * b + c * c)) / h;
        sum += weight(q) * q * q;
      }
    }
  }
  return d / sum;
}

template <class Real>
double Viscosity<Real>::multiply(const Neighbourhood<Real>& near, Real dt) {
  using V = Vector<Real>;
  const Real k = Real(2 * (near.dimension + 2) * weight_scale(near)) * dt / (near.h * near.h);
  return ordered_sum(
      near.size(),
      [&](std::int64_t i) {
        const Point<Real> pi = p_[i];
        const Real w = near.x[i].w;
        V x{}, y{}, z{};
        for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
          const PointLanes<V> pj = load_points<V>(p_.data(), pair.index);
          const V mu = 2 * pi.w * pj.w / (pi.w + pj.w);
          const V along = (pi.x - pj.x) * pair.x + (pi.y - pj.y) * pair.y + (pi.z - pj.z) * pair.z;
          const V c = mu * weight(pair.q) * pair.inverse_r * pair.inverse_r * along;
          x = fma<V>(c, pair.x, x);
          y = fma<V>(c, pair.y, y);
          z = fma<V>(c, pair.z, z);
        });
        const Real s = k * w;
        f_[i] = {pi.x + s * sum_lanes(x), pi.y + s * sum_lanes(y), pi.z + s * sum_lanes(z), 0};
        return dot(pi, f_[i]) / double(w);
      },
      near.threads);
}

template <class Real>
ViscosityReport Viscosity<Real>::solve(const Neighbourhood<Real>& near, std::span<const Real> nu,
                                       Real dt, Real tolerance, int max_iterations,
                                       std::span<Point<Real>> v) {
  const std::int64_t n = near.size();
  p_.resize(n + 1), f_.resize(n), r_.resize(n);
  for (std::int64_t i = 0; i < n; ++i) {
    const Point<Real>& vi = near.v[i];
    const Real ni = std::max(nu[nu.size() == 1 ? 0 : i], kNone);
    p_[i] = {vi.x, vi.y, vi.z, ni / near.x[i].w};
  }
  p_[n] = {0, 0, 0, 1};
  std::copy(near.v.begin(), near.v.end(), v.begin());
  multiply(near, dt);  // of v itself
  double rr = ordered_sum(
      n,
      [&](std::int64_t i) {
        r_[i] = add_scaled(near.v[i], Real(-1), f_[i]);
        p_[i] = {r_[i].x, r_[i].y, r_[i].z, p_[i].w};
        return dot(r_[i], r_[i]) / double(near.x[i].w);
      },
      near.threads);
  const double start = rr;
  ViscosityReport report;
  while (rr > double(tolerance) * double(tolerance) * start && rr > 0) {
    if (report.iterations == max_iterations) {
      report.converged = false;
      break;
    }
    poll_interrupt();
    const Real alpha = Real(rr / multiply(near, dt));
    const double next = ordered_sum(
        n,
        [&](std::int64_t i) {
          v[i] = add_scaled(v[i], alpha, p_[i]);
          r_[i] = add_scaled(r_[i], -alpha, f_[i]);
          return dot(r_[i], r_[i]) / double(near.x[i].w);
        },
        near.threads);
    const Real beta = Real(next / rr);
    ordered_sum(
        n,
        [&](std::int64_t i) {
          p_[i] = {r_[i].x + beta * p_[i].x, r_[i].y + beta * p_[i].y, r_[i].z + beta * p_[i].z,
                   p_[i].w};
          return 0.;
        },
        near.threads);
    rr = next;
    ++report.iterations;
  }
  report.residual = start > 0 ? std::sqrt(rr / start) : 0;
  return report;
}

template class Viscosity<float>;
template class Viscosity<double>;

}  // namespace substep::pbf
