#include "substep/pbf/projection.h"

#include <algorithm>
#include <cmath>

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

}  // namespace

template <class Real>
void VelocityProjection<Real>::prepare(const Neighbourhood<Real>& near, const Walls& walls,
                                       double surface_density, double dt) {
  using V = Vector<Real>;
  constexpr double kLeastDeterminant = 0.2;  // of 1 in the lattice
  const std::int64_t n = near.size();
  l_.resize(usize(n)), allowed_.resize(usize(n)), own_.resize(usize(n));
  const Real k = gradient_scale(near), value = near.volume * kernel_scale(near);
  const Real own = value * CubicSpline::value(Vector<Real>{})[0];
  const bool planar = near.dimension == 2;
  const auto particle = [&](std::int64_t i) {
    PointLanes<V> g{}, m{}, q{};  // of gradients, and W; of M: xx, yy, zz; and of squares
    V mxy{}, mxz{}, myz{}, qxy{}, qxz{}, qyz{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const V f = CubicSpline::slope<V>(pair.q) * pair.inverse_r;
      const V fx = f * pair.x, fy = f * pair.y, fz = f * pair.z;
      const V wf = pair.inverse_mass * f;
      g.w += CubicSpline::value<V>(pair.q);
      g.x += fx, g.y += fy, g.z += fz;
      m.x = fma<V>(fx, pair.x, m.x), m.y = fma<V>(fy, pair.y, m.y), m.z = fma<V>(fz, pair.z, m.z);
      mxy = fma<V>(fx, pair.y, mxy), mxz = fma<V>(fx, pair.z, mxz), myz = fma<V>(fy, pair.z, myz);
      const V qx = wf * pair.x, qy = wf * pair.y, qz = wf * pair.z;
      q.x = fma<V>(fx, qx, q.x), q.y = fma<V>(fy, qy, q.y), q.z = fma<V>(fz, qz, q.z);
      qxy = fma<V>(fx, qy, qxy), qxz = fma<V>(fx, qz, qxz), qyz = fma<V>(fy, qz, qyz);
    });
    const Symmetric<Real>& moment = walls.moments[usize(i)];
    const Real density = value * sum_lanes(g.w) + own + walls.contributions[usize(i)].w;
    const double room = surface_density - double(density);
    allowed_[usize(i)] = static_cast<Real>(std::max(0.0, room) / dt);
    Symmetric<Real> m_i{
        {moment.diagonal.x - k * sum_lanes(m.x), moment.diagonal.y - k * sum_lanes(m.y),
         planar ? Real(1) : moment.diagonal.z - k * sum_lanes(m.z), 0},
        {moment.off.x - k * sum_lanes(mxy), moment.off.y - k * sum_lanes(mxz),
         moment.off.z - k * sum_lanes(myz), 0}};
    Symmetric<Real>& l = l_[usize(i)];
    const bool within = room < 0 && m_i.determinant() > kLeastDeterminant;
    l = within ? m_i.inverse() : Symmetric<Real>::identity();
    const Point<Real> sum =
        l.times({k * sum_lanes(g.x), k * sum_lanes(g.y), k * sum_lanes(g.z), 0});
    // sum_j w_j |L g_ij|^2 = trace(L Q L), Q = sum_j w_j g_ij g_ij^T
    const Symmetric<Real> squares{{sum_lanes(q.x), sum_lanes(q.y), sum_lanes(q.z), 0},
                                  {sum_lanes(qxy), sum_lanes(qxz), sum_lanes(qyz), 0}};
    const Point<Real> rows[3] = {l.times({1, 0, 0, 0}), l.times({0, 1, 0, 0}),
                                 l.times({0, 0, 1, 0})};
    Real trace = 0;
    for (const Point<Real>& row : rows) {
      const Point<Real> along = squares.times(row);
      trace += row.x * along.x + row.y * along.y + row.z * along.z;
    }
    own_[usize(i)] = {sum.x, sum.y, sum.z, k * k * trace};
  };
  for_particles(n, particle, near.threads);
}

// u = M^-1 c'^T lambda.
template <class Real>
void VelocityProjection<Real>::spread(std::span<const Real> lambda, const Neighbourhood<Real>& near,
                                      std::span<const Point<Real>> walls) {
  using V = Vector<Real>;
  const std::int64_t n = near.size();
  const Real k = gradient_scale(near);
  for_particles(
      n,
      [&](std::int64_t i) {
        const Symmetric<Real>& l = l_[usize(i)];
        const Real a = lambda[usize(i)];
        s_[usize(i)] = {a * l.diagonal.x, a * l.diagonal.y, a * l.diagonal.z, 0};
        t_[usize(i)] = {a * l.off.x, a * l.off.y, a * l.off.z, 0};
      },
      near.threads);
  const auto particle = [&](std::int64_t i) {
    const Point<Real> si = s_[usize(i)], ti = t_[usize(i)];
    PointLanes<V> u{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const PointLanes<V> sj = load_points<V>(s_.data(), pair.index),
                          tj = load_points<V>(t_.data(), pair.index);
      const V f = CubicSpline::slope<V>(pair.q) * pair.inverse_r;
      const V fx = f * pair.x, fy = f * pair.y, fz = f * pair.z;
      const V xy = ti.x + tj.x, xz = ti.y + tj.y, yz = ti.z + tj.z;
      u.x = fma<V>(si.x + sj.x, fx, fma<V>(xy, fy, fma<V>(xz, fz, u.x)));
      u.y = fma<V>(xy, fx, fma<V>(si.y + sj.y, fy, fma<V>(yz, fz, u.y)));
      u.z = fma<V>(xz, fx, fma<V>(yz, fy, fma<V>(si.z + sj.z, fz, u.z)));
    });
    const Quad<Real> sum = sum_points<V>(u);
    const Point<Real>& wall = walls[usize(i)];
    const Real a = lambda[usize(i)], w = near.x[usize(i)].w;
    u_[usize(i)] = {w * (k * sum[0] + a * wall.x), w * (k * sum[1] + a * wall.y),
                    w * (k * sum[2] + a * wall.z), 0};
  };
  for_particles(n, particle, near.threads);
}

// The sum of use(i, c_i(v)).
template <class Real>
template <class Use>
double VelocityProjection<Real>::compress(std::span<const Point<Real>> v,
                                          const Neighbourhood<Real>& near,
                                          std::span<const Point<Real>> walls,
                                          const Use& use) const {
  using V = Vector<Real>;
  const Real k = gradient_scale(near);
  return ordered_sum(
      near.size(),
      [&](std::int64_t i) {
        const Point<Real> vi = v[usize(i)];
        PointLanes<V> d{}, o{};
        for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
          const PointLanes<V> vj = load_points<V>(v.data(), pair.index);
          const V f = CubicSpline::slope<V>(pair.q) * pair.inverse_r;
          const V ux = f * (vi.x - vj.x), uy = f * (vi.y - vj.y), uz = f * (vi.z - vj.z);
          d.x = fma<V>(pair.x, ux, d.x);
          d.y = fma<V>(pair.y, uy, d.y);
          d.z = fma<V>(pair.z, uz, d.z);
          o.x = fma<V>(pair.x, uy, fma<V>(pair.y, ux, o.x));
          o.y = fma<V>(pair.x, uz, fma<V>(pair.z, ux, o.y));
          o.z = fma<V>(pair.y, uz, fma<V>(pair.z, uy, o.z));
        });
        const Symmetric<Real>& l = l_[usize(i)];
        const Quad<Real> ds = sum_points<V>(d), os = sum_points<V>(o);
        const Point<Real>& wall = walls[usize(i)];
        const Real c = k * (l.diagonal.x * ds[0] + l.diagonal.y * ds[1] + l.diagonal.z * ds[2] +
                            l.off.x * os[0] + l.off.y * os[1] + l.off.z * os[2]) +
                       wall.x * vi.x + wall.y * vi.y + wall.z * vi.z;
        return use(i, c);
      },
      near.threads);
}

template <class Real>
ProjectionReport VelocityProjection<Real>::project(const Neighbourhood<Real>& near,
                                                   std::span<const Point<Real>> walls, double dt,
                                                   double tolerance, int max_iterations,
                                                   std::span<Real> lambda,
                                                   std::span<Point<Real>> v) {
  const std::int64_t n = near.size();
  const auto rows = usize(n) + 1;
  s_.resize(rows), t_.resize(rows), u_.resize(rows);
  s_[rows - 1] = t_[rows - 1] = u_[rows - 1] = {0, 0, 0, 0};
  r_.resize(usize(n)), p_.resize(usize(n)), ap_.resize(usize(n)), free_.resize(usize(n));
  inverse_diagonal_.resize(usize(n));
  ProjectionReport report;
  if (n == 0) return report;
  for_particles(
      n,
      [&](std::int64_t i) {
        const Point<Real>&o = own_[usize(i)], &wall = walls[usize(i)];
        const Real x = o.x + wall.x, y = o.y + wall.y, z = o.z + wall.z;
        const Real diagonal = near.x[usize(i)].w * (x * x + y * y + z * z) + o.w;
        inverse_diagonal_[usize(i)] = diagonal > 0 ? 1 / diagonal : 0;
      },
      near.threads);
  // r = c(v - u(lambda)) - a, over all; z = r / D where lambda may change.
  now_.resize(rows);
  const auto begin = [&] {
    spread(lambda, near, walls);
    for_particles(
        n,
        [&](std::int64_t i) {
          const Point<Real>&a = v[usize(i)], &u = u_[usize(i)];
          now_[usize(i)] = {a.x - u.x, a.y - u.y, a.z - u.z, 0};
        },
        near.threads);
    now_[rows - 1] = {0, 0, 0, 0};
    return compress(now_, near, walls, [&](std::int64_t i, Real c) {
      const Real r = r_[usize(i)] = c - walls[usize(i)].w - allowed_[usize(i)];
      free_[usize(i)] = lambda[usize(i)] > 0 || r > 0;
      const Real z = p_[usize(i)] = free_[usize(i)] ? r * inverse_diagonal_[usize(i)] : 0;
      return double(r) * double(z);
    });
  };
  const auto error = [&] {
    return dt / static_cast<double>(n) *
           ordered_sum(
               n,
               [&](std::int64_t i) {
                 const double r = double(r_[usize(i)]);
                 return free_[usize(i)] ? std::abs(r) : std::max(r, 0.0);
               },
               near.threads);
  };
  double rz = begin();
  while (true) {
    report.error = error();
    report.converged = report.error <= tolerance;
    if (report.converged || report.iterations >= max_iterations) break;
    poll_interrupt();
    ++report.iterations;
    spread(p_, near, walls);
    const double pap = compress(u_, near, walls, [&](std::int64_t i, Real c) {
      ap_[usize(i)] = c;
      return double(c) * double(p_[usize(i)]);
    });
    if (!(pap > 0)) break;
    const Real alpha = static_cast<Real>(rz / pap);
    // Whether a multiplier ended at 0, and whether one may leave it.
    struct Change {
      double rz = 0;
      bool ended = false, left = false;
      void operator+=(const Change& o) { rz += o.rz, ended |= o.ended, left |= o.left; }
    };
    const Change change = ordered_sum(
        n,
        [&](std::int64_t k) {
          const auto i = usize(k);
          Change here;
          Real next = lambda[i] + alpha * p_[i];
          if (next < 0) next = 0, here.ended = true;
          lambda[i] = next;
          r_[i] -= alpha * ap_[i];
          if (!free_[i] && r_[i] > 0) free_[i] = 1, here.left = true;
          if (free_[i]) here.rz = double(r_[i]) * double(r_[i]) * double(inverse_diagonal_[i]);
          return here;
        },
        near.threads);
    if (change.ended) {
      rz = begin();
      continue;
    }
    const Real beta = change.left ? Real(0) : static_cast<Real>(change.rz / rz);
    rz = change.rz;
    for_particles(
        n,
        [&](std::int64_t k) {
          const auto i = usize(k);
          p_[i] = (free_[i] ? r_[i] * inverse_diagonal_[i] : 0) + beta * p_[i];
        },
        near.threads);
  }
  spread(lambda, near, walls);
  for_particles(
      n,
      [&](std::int64_t i) {
        Point<Real>& a = v[usize(i)];
        const Point<Real>& u = u_[usize(i)];
        a = {a.x - u.x, a.y - u.y, a.z - u.z, a.w};
      },
      near.threads);
  return report;
}

template class VelocityProjection<float>;
template class VelocityProjection<double>;

}  // namespace substep::pbf
