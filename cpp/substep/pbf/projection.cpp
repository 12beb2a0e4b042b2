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
  find_corrections(near, walls, surface_density, dt);
  find_gradients(near);
}

template <class Real>
void VelocityProjection<Real>::find_corrections(const Neighbourhood<Real>& near, const Walls& walls,
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

template <class Real>
void VelocityProjection<Real>::find_gradients(const Neighbourhood<Real>& near) {
  using V = Vector<Real>;
  constexpr std::int64_t kLanes = sizeof(V) / sizeof(Real);
  const std::int64_t n = near.size();
  begin_.resize(usize(n)), own_.resize(usize(n));
  std::int64_t blocks = 0;
  for (std::int64_t i = 0; i < n; ++i) {
    begin_[usize(i)] = blocks;
    blocks += (near.lists[i].count + kLanes - 1) / kLanes;
  }
  if (rows_.size() < usize(blocks)) rows_.resize(usize(blocks));
  if (columns_.size() < usize(blocks)) columns_.resize(usize(blocks));
  const Real k = gradient_scale(near);
  const auto particle = [&](std::int64_t i) {
    const Symmetric<Real>& l = l_[usize(i)];
    std::size_t at = usize(begin_[usize(i)]);
    PointLanes<V> sum{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const V f = k * CubicSpline::slope<V>(pair.q) * pair.inverse_r;
      const V gx = f * pair.x, gy = f * pair.y, gz = f * pair.z;
      const auto diagonal = load_rows<V>([&](int j) { return &l_[usize(pair.index[j])].diagonal; });
      const auto off = load_rows<V>([&](int j) { return &l_[usize(pair.index[j])].off; });
      const V x = l.diagonal.x * gx + l.off.x * gy + l.off.y * gz,
              y = l.off.x * gx + l.diagonal.y * gy + l.off.z * gz,
              z = l.off.y * gx + l.off.z * gy + l.diagonal.z * gz;
      rows_[at] = {x, y, z};
      columns_[at] = {diagonal.x * gx + off.x * gy + off.y * gz,
                      off.x * gx + diagonal.y * gy + off.z * gz,
                      off.y * gx + off.z * gy + diagonal.z * gz};
      ++at;
      sum.x += x, sum.y += y, sum.z += z;
      sum.w = fma<V>(pair.inverse_mass, fma<V>(x, x, fma<V>(y, y, z * z)), sum.w);
    });
    store_quad(own_[usize(i)], sum_points<V>(sum));
  };
  for_particles(n, particle, near.threads);
}

// u = M^-1 c'^T lambda.
template <class Real>
void VelocityProjection<Real>::spread(std::span<const Real> lambda,
                                      const Neighbourhood<Real>& near) {
  using V = Vector<Real>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  const auto particle = [&](std::int64_t i) {
    const geometry::NeighbourList list = near.lists[i];
    const Gradients* g = columns_.data() + begin_[usize(i)];
    V x{}, y{}, z{};
    for (int at = 0; at < list.count; at += kLanes, ++g) {
      const V of_j = gather<V>(lambda.data(), list.indices + at);
      x = fma<V>(of_j, g->x, x), y = fma<V>(of_j, g->y, y), z = fma<V>(of_j, g->z, z);
    }
    const Quad<Real> sum = sum_points<V>({x, y, z, V{}});
    const Point<Real>& own = own_[usize(i)];
    const Real a = lambda[usize(i)], w = near.x[usize(i)].w;
    u_[usize(i)] = {w * (sum[0] + a * own.x), w * (sum[1] + a * own.y), w * (sum[2] + a * own.z),
                    0};
  };
  for_particles(near.size(), particle, near.threads);
}

// The sum of use(i, c_i(v)).
template <class Real>
template <class Use>
double VelocityProjection<Real>::compress(std::span<const Point<Real>> v,
                                          const Neighbourhood<Real>& near,
                                          std::span<const Point<Real>> walls,
                                          const Use& use) const {
  using V = Vector<Real>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  return ordered_sum(
      near.size(),
      [&](std::int64_t i) {
        const Point<Real>&vi = v[usize(i)], &wall = walls[usize(i)];
        const geometry::NeighbourList list = near.lists[i];
        const Gradients* g = rows_.data() + begin_[usize(i)];
        V c{};
        for (int at = 0; at < list.count; at += kLanes, ++g) {
          const PointLanes<V> vj = load_points<V>(v.data(), list.indices + at);
          c = fma<V>(g->x, vi.x - vj.x, fma<V>(g->y, vi.y - vj.y, fma<V>(g->z, vi.z - vj.z, c)));
        }
        return use(i, sum_lanes(c) + wall.x * vi.x + wall.y * vi.y + wall.z * vi.z);
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
  u_.resize(rows), now_.resize(rows), p_.resize(rows);
  u_[rows - 1] = now_[rows - 1] = {0, 0, 0, 0};
  p_[rows - 1] = 0;
  r_.resize(usize(n)), ap_.resize(usize(n)), free_.resize(usize(n));
  inverse_diagonal_.resize(usize(n));
  ProjectionReport report;
  if (n == 0) return report;
  for_particles(
      n,
      [&](std::int64_t i) {
        Point<Real>& o = own_[usize(i)];
        const Point<Real>& wall = walls[usize(i)];
        o.x += wall.x, o.y += wall.y, o.z += wall.z;
        const Real diagonal = near.x[usize(i)].w * (o.x * o.x + o.y * o.y + o.z * o.z) + o.w;
        inverse_diagonal_[usize(i)] = diagonal > 0 ? 1 / diagonal : 0;
        if (!(diagonal > 0)) lambda[usize(i)] = 0;  // nobody is near
      },
      near.threads);
  // r = c(v - u(lambda)) - a, over all; z = r / D where lambda may change.
  const auto begin = [&] {
    spread(lambda, near);
    for_particles(
        n,
        [&](std::int64_t i) {
          const Point<Real>&a = v[usize(i)], &u = u_[usize(i)];
          now_[usize(i)] = {a.x - u.x, a.y - u.y, a.z - u.z, a.w};
        },
        near.threads);
    return compress(now_, near, walls, [&](std::int64_t i, Real c) {
      const Real r = r_[usize(i)] = c - walls[usize(i)].w - allowed_[usize(i)];
      free_[usize(i)] = inverse_diagonal_[usize(i)] > 0 && (lambda[usize(i)] > 0 || r > 0);
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
                 return free_[usize(i)]                   ? std::abs(r)
                        : inverse_diagonal_[usize(i)] > 0 ? std::max(r, 0.0)
                                                          : 0.0;
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
    spread(p_, near);
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
          now_[i].x -= alpha * u_[i].x, now_[i].y -= alpha * u_[i].y, now_[i].z -= alpha * u_[i].z;
          if (!free_[i] && r_[i] > 0 && inverse_diagonal_[i] > 0) free_[i] = 1, here.left = true;
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
  std::copy(now_.begin(), now_.end(), v.begin());
  return report;
}

template class VelocityProjection<float>;
template class VelocityProjection<double>;

}  // namespace substep::pbf
