#include "substep/pbf/projection.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/interrupt.h"
#include "substep/core/usize.h"
#include "substep/pbf/sums.h"

namespace substep::pbf {
namespace {

// W' / r of the cubic spline, times V.
template <class Real>
Real gradient_scale(const Neighbourhood<Real>& near) {
  return near.volume * kernel_scale(near) / near.h;
}

// Of a step of conjugate gradients along p, that is tried first.
constexpr double kShortest = 0.1, kLongest = 10;

template <class V>
SUBSTEP_INLINE void add(const V& factor, const Vector3<V>& g, PointLanes<V>& sum) {
  sum.x = fma<V>(factor, g[0], sum.x), sum.y = fma<V>(factor, g[1], sum.y);
  sum.z = fma<V>(factor, g[2], sum.z);
}

}  // namespace

template <class Real>
void VelocityProjection<Real>::prepare(const Neighbourhood<Real>& near, const Walls& walls,
                                       double surface_density, double dt) {
  using V = Vector<Real>;
  constexpr double kLeastDeterminant = 0.2;  // of 1 in the lattice
  const std::int64_t n = near.size();
  l_.resize(usize(n) + 1), allowed_.resize(usize(n));
  l_[usize(n)] = Symmetric<Real>::identity();
  const Real k = gradient_scale(near), value = near.volume * kernel_scale(near);
  const Real own = value * CubicSpline::value(Vector<Real>{})[0];
  const bool planar = near.dimension == 2;
  const auto particle = [&](std::int64_t i) {
    PointLanes<V> m{}, off{};  // of M: xx, yy, zz; and xy, xz, yz; w: of W
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const V f = CubicSpline::slope<V>(pair.q) * pair.inverse_r;
      const V fx = f * pair.x, fy = f * pair.y, fz = f * pair.z;
      m.w += CubicSpline::value<V>(pair.q);
      m.x = fma<V>(fx, pair.x, m.x), m.y = fma<V>(fy, pair.y, m.y), m.z = fma<V>(fz, pair.z, m.z);
      off.x = fma<V>(fx, pair.y, off.x);
      off.y = fma<V>(fx, pair.z, off.y);
      off.z = fma<V>(fy, pair.z, off.z);
    });
    const Quad<Real> diagonal = sum_points<V>(m), rest = sum_points<V>(off);
    const Symmetric<Real>& wall = walls.moments[usize(i)];
    const Real density = value * diagonal[3] + own + walls.contributions[usize(i)].w;
    const double room = surface_density - double(density);
    allowed_[usize(i)] = static_cast<Real>(std::max(0.0, room) / dt);
    const Symmetric<Real> m_i{
        {wall.diagonal.x - k * diagonal[0], wall.diagonal.y - k * diagonal[1],
         planar ? Real(1) : wall.diagonal.z - k * diagonal[2], 0},
        {wall.off.x - k * rest[0], wall.off.y - k * rest[1], wall.off.z - k * rest[2], 0}};
    const bool within = room < 0 && m_i.determinant() > kLeastDeterminant;
    l_[usize(i)] = within ? m_i.inverse() : Symmetric<Real>::identity();
  };
  for_particles(n, particle, near.threads);
}

// Rows, columns and diagonal of c', and u.
template <class Real>
void VelocityProjection<Real>::find_gradients(const Neighbourhood<Real>& near,
                                              std::span<const Point<Real>> walls,
                                              std::span<const Real> lambda) {
  using V = Vector<Real>;
  constexpr std::int64_t kLanes = sizeof(V) / sizeof(Real);
  const std::int64_t n = near.size();
  begin_.resize(usize(n)), own_.resize(usize(n)), inverse_diagonal_.resize(usize(n));
  std::int64_t blocks = 0;
  for (std::int64_t i = 0; i < n; ++i) {
    begin_[usize(i)] = blocks;
    blocks += (near.lists[i].count + kLanes - 1) / kLanes;
  }
  if (rows_.size() < usize(blocks)) rows_.resize(usize(blocks)), columns_.resize(usize(blocks));
  const Real k = gradient_scale(near);
  const auto particle = [&](std::int64_t i) {
    const Symmetric<Real>& l = l_[usize(i)];
    Vector3<V>*row = rows_.data() + begin_[usize(i)], *column = columns_.data() + begin_[usize(i)];
    PointLanes<V> sum{}, u{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const V f = k * CubicSpline::slope<V>(pair.q) * pair.inverse_r;
      const V gx = f * pair.x, gy = f * pair.y, gz = f * pair.z;
      const V x = l.diagonal.x * gx + l.off.x * gy + l.off.y * gz,
              y = l.off.x * gx + l.diagonal.y * gy + l.off.z * gz,
              z = l.off.y * gx + l.off.z * gy + l.diagonal.z * gz;
      *row++ = {{x, y, z}};
      sum.x += x, sum.y += y, sum.z += z;
      sum.w = fma<V>(pair.inverse_mass, fma<V>(x, x, fma<V>(y, y, z * z)), sum.w);
      const auto diagonal = load_rows<V>([&](int j) { return &l_[usize(pair.index[j])].diagonal; });
      const auto off = load_rows<V>([&](int j) { return &l_[usize(pair.index[j])].off; });
      *column = {{diagonal.x * gx + off.x * gy + off.y * gz,
                  off.x * gx + diagonal.y * gy + off.z * gz,
                  off.y * gx + off.z * gy + diagonal.z * gz}};
      add(gather<V>(lambda.data(), pair.index), *column++, u);
    });
    const Point<Real>& wall = walls[usize(i)];
    const Quad<Real> all = sum_points<V>(sum) + Quad<Real>{wall.x, wall.y, wall.z, 0};
    store_quad(own_[usize(i)], all);
    const Real w = near.x[usize(i)].w,
               diagonal = w * (all[0] * all[0] + all[1] * all[1] + all[2] * all[2]) + all[3];
    inverse_diagonal_[usize(i)] = diagonal > 0 ? 1 / diagonal : 0;  // 0: nobody is near
    set_u(i, w, lambda[usize(i)], sum_points<V>(u));
  };
  for_particles(n, particle, near.threads);
}

template <class Real>
void VelocityProjection<Real>::spread(std::span<const Real> lambda,
                                      const Neighbourhood<Real>& near) {
  using V = Vector<Real>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  const auto particle = [&](std::int64_t i) {
    const geometry::NeighbourList list = near.lists[i];
    const Vector3<V>* column = columns_.data() + begin_[usize(i)];
    PointLanes<V> u{};
    for (int at = 0; at < list.count; at += kLanes)
      add(gather<V>(lambda.data(), list.indices + at), *column++, u);
    set_u(i, near.x[usize(i)].w, lambda[usize(i)], sum_points<V>(u));
  };
  for_particles(near.size(), particle, near.threads);
}

// The sum of use(i, c_i(v)).
template <class Real>
template <class Use>
auto VelocityProjection<Real>::compress(std::span<const Point<Real>> v,
                                        const Neighbourhood<Real>& near,
                                        std::span<const Point<Real>> walls, const Use& use) const {
  using V = Vector<Real>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  return ordered_sum(
      near.size(),
      [&](std::int64_t i) {
        const Point<Real>&vi = v[usize(i)], &wall = walls[usize(i)];
        const geometry::NeighbourList list = near.lists[i];
        const Vector3<V>* row = rows_.data() + begin_[usize(i)];
        V c{};
        for (int at = 0; at < list.count; at += kLanes) {
          const PointLanes<V> vj = load_points<V>(v.data(), list.indices + at);
          const Vector3<V>& g = *row++;
          c = fma<V>(g[0], vi.x - vj.x, fma<V>(g[1], vi.y - vj.y, fma<V>(g[2], vi.z - vj.z, c)));
        }
        return use(usize(i), sum_lanes(c) + wall.x * vi.x + wall.y * vi.y + wall.z * vi.z);
      },
      near.threads);
}

template <class Real>
ProjectionReport VelocityProjection<Real>::project(const Neighbourhood<Real>& near,
                                                   std::span<const Point<Real>> walls,
                                                   std::span<const YieldingBody<Real>> bodies,
                                                   double dt, double tolerance, int max_iterations,
                                                   std::span<Real> lambda,
                                                   std::span<Point<Real>> v) {
  const std::int64_t n = near.size();
  const auto rows = usize(n) + 1;
  u_.resize(rows);
  u_[rows - 1] = {0, 0, 0, 0};
  r_.resize(usize(n)), ap_.resize(usize(n));
  p_.assign(rows, 0), step_.assign(rows, 0);
  pull_.assign(bodies.empty() ? 0 : usize(n), 0);
  ProjectionReport report;
  if (n == 0) return report;
  // Of the particles whose multipliers may change: of |r|, r . z and (r - r before) . z, z = r / D.
  struct Sums {
    double error = 0, rz = 0, change = 0;
    void operator+=(const Sums& o) { error += o.error, rz += o.rz, change += o.change; }
  };
  const auto is_free = [&](std::size_t i) {
    return inverse_diagonal_[i] > 0 && (lambda[i] > 0 || r_[i] > 0);
  };
  const auto set_residual = [&](std::size_t i, Real r) {
    const double before = double(r_[i]);
    r_[i] = r;
    if (!is_free(i)) return Sums{};
    const double z = double(r) * double(inverse_diagonal_[i]);
    return Sums{std::abs(double(r)), double(r) * z, (double(r) - before) * z};
  };
  // The bodies' part of z = P^-1 r in those sums, and of each z.
  const auto yield = [&](Sums& sums) {
    for (const YieldingBody<Real>& body : bodies) {
      for (const BodyRow& row : body.rows) pull_[usize(row.particle)] = 0;
    }
    for (const YieldingBody<Real>& body : bodies) {
      Mat6 k = Mat6::Zero();
      Vec6 f = Vec6::Zero(), change = Vec6::Zero();
      for (const BodyRow& row : body.rows) {
        const auto i = usize(row.particle);
        if (!is_free(i)) continue;
        const Vec6 scaled = double(inverse_diagonal_[i]) * row.q;
        k += scaled * row.q.transpose();
        f += double(r_[i]) * scaled;
        change += (double(r_[i]) - double(r_before_[i])) * scaled;
      }
      const Vec6 y = respond(body.mobility, k, f);
      for (const BodyRow& row : body.rows) {
        pull_[usize(row.particle)] += static_cast<Real>(row.q.dot(y));
      }
      sums.rz -= f.dot(y);
      sums.change -= change.dot(y);
    }
  };
  find_gradients(near, walls, lambda);
  for_particles(
      n,
      [&](std::int64_t k) {
        const auto i = usize(k);
        if (inverse_diagonal_[i] == 0) lambda[i] = 0;
        v[i].x -= u_[i].x, v[i].y -= u_[i].y, v[i].z -= u_[i].z;
      },
      near.threads);
  Sums sums = compress(v, near, walls, [&](std::size_t i, Real c) {
    return set_residual(i, c - walls[i].w - allowed_[i]);
  });
  if (!bodies.empty()) r_before_.assign(r_.begin(), r_.end());
  yield(sums);
  Real alpha = 1, beta = 0;
  while (true) {
    report.error = dt / static_cast<double>(n) * sums.error;
    report.converged = report.error <= tolerance;
    if (report.converged || report.iterations >= max_iterations) break;
    poll_interrupt();
    ++report.iterations;
    // A step along p, cut where a multiplier would fall below 0.
    struct Step {
      double sr = 0, most = std::numeric_limits<double>::infinity();  // s . r; the longest in s
      void operator+=(const Step& o) { sr += o.sr, most = std::min(most, o.most); }
    };
    const Step step = ordered_sum(
        n,
        [&](std::int64_t k) {
          const auto i = usize(k);
          const Real r = pull_.empty() ? r_[i] : r_[i] - pull_[i];
          p_[i] = is_free(i) ? r * inverse_diagonal_[i] + beta * p_[i] : 0;
          Real& s = step_[i];
          s = alpha * p_[i];
          if (lambda[i] + s < 0) s = -lambda[i], p_[i] = s / alpha;
          Step here{double(s) * double(r_[i])};
          if (s < 0) here.most = double(lambda[i]) / -double(s);
          return here;
        },
        near.threads);
    spread(step_, near);
    double sas = compress(u_, near, walls, [&](std::size_t i, Real c) {
      ap_[i] = c;
      return double(c) * double(step_[i]);
    });
    for (const YieldingBody<Real>& body : bodies) {
      const Vec6 gained = body.gained(step_);
      for (const BodyRow& row : body.rows) {
        const double c = row.q.dot(gained);
        ap_[usize(row.particle)] += static_cast<Real>(c);
        sas += c * double(step_[usize(row.particle)]);
      }
    }
    if (!(sas > 0)) break;
    const double best = step.sr / sas;
    if (!(best > 0)) {  // leads nowhere
      if (beta == 0) break;
      beta = 0;
      continue;
    }
    const Real length = static_cast<Real>(std::min(best, step.most));
    const double rz = sums.rz;
    if (!bodies.empty()) r_before_.assign(r_.begin(), r_.end());
    sums = ordered_sum(
        n,
        [&](std::int64_t k) {
          const auto i = usize(k);
          lambda[i] = std::max(lambda[i] + length * step_[i], Real(0));
          v[i].x -= length * u_[i].x, v[i].y -= length * u_[i].y, v[i].z -= length * u_[i].z;
          return set_residual(i, r_[i] - length * ap_[i]);
        },
        near.threads);
    yield(sums);
    alpha = static_cast<Real>(std::clamp(best * double(alpha), kShortest, kLongest));
    beta = static_cast<Real>(std::max(sums.change / rz, 0.0));
  }
  return report;
}

template class VelocityProjection<float>;
template class VelocityProjection<double>;

}  // namespace substep::pbf
