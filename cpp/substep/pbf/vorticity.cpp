#include "substep/pbf/vorticity.h"

#include <cmath>

#include "substep/pbf/sums.h"

namespace substep::pbf {
namespace {

struct Momentum {
  double x, y, z, length;
  Momentum& operator+=(const Momentum& o) {
    x += o.x, y += o.y, z += o.z, length += o.length;
    return *this;
  }
};

}  // namespace

template <class Real>
void vorticity(const Neighbourhood<Real>& near, std::span<Point<Real>> omega) {
  using V = Vector<Real>;
  const Real k = near.volume * kernel_scale(near) / near.h;
  const auto particle = [&](std::int64_t i) {
    const Point<Real> vi = near.v[i];
    V x{}, y{}, z{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const PointLanes<V> vj = load_points<V>(near.v.data(), pair.index);
      const V g = CubicSpline::slope<V>(pair.q) * pair.inverse_r;
      const V ux = vj.x - vi.x, uy = vj.y - vi.y, uz = vj.z - vi.z;
      x = fma<V>(g, pair.y * uz - pair.z * uy, x);
      y = fma<V>(g, pair.z * ux - pair.x * uz, y);
      z = fma<V>(g, pair.x * uy - pair.y * ux, z);
    });
    Point<Real> w{k * sum_lanes(x), k * sum_lanes(y), k * sum_lanes(z), 0};
    w.w = std::sqrt(w.x * w.x + w.y * w.y + w.z * w.z);
    omega[i] = w;
  };
  for_particles(near.size(), particle, near.threads);
  omega[near.size()] = {0, 0, 0, 0};
}

template <class Real>
void VorticityConfinement<Real>::apply(const Neighbourhood<Real>& near, Real epsilon, Real dt,
                                       std::span<Point<Real>> v) {
  using V = Vector<Real>;
  omega_.resize(near.x.size()), impulse_.resize(near.size());
  vorticity<Real>(near, omega_);
  const auto push = [&](std::int64_t i) {
    const Point<Real> omega = omega_[i];
    V x{}, y{}, z{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const PointLanes<V> other = load_points<V>(omega_.data(), pair.index);
      const V g = CubicSpline::slope<V>(pair.q) * pair.inverse_r * (other.w - omega.w);
      x = fma<V>(g, pair.x, x);
      y = fma<V>(g, pair.y, y);
      z = fma<V>(g, pair.z, z);
    });
    const Real ex = sum_lanes(x), ey = sum_lanes(y), ez = sum_lanes(z);  // eta, times a number
    const Real length = std::sqrt(ex * ex + ey * ey + ez * ez);
    const Real s = length > 0 ? dt * epsilon / (near.x[i].w * length) : 0;
    Point<Real> j{s * (ey * omega.z - ez * omega.y), s * (ez * omega.x - ex * omega.z),
                  s * (ex * omega.y - ey * omega.x), 0};
    j.w = std::sqrt(j.x * j.x + j.y * j.y + j.z * j.z);
    impulse_[i] = j;
    return Momentum{double(j.x), double(j.y), double(j.z), double(j.w)};
  };
  const Momentum net = ordered_sum(near.size(), push, near.threads);
  if (!(net.length > 0)) return;
  const Real x = Real(net.x / net.length), y = Real(net.y / net.length),
             z = Real(net.z / net.length);
  const auto move = [&](std::int64_t i) {
    const Point<Real> j = impulse_[i];
    const Real per_mass = near.x[i].w;
    v[i].x += (j.x - j.w * x) * per_mass;
    v[i].y += (j.y - j.w * y) * per_mass;
    v[i].z += (j.z - j.w * z) * per_mass;
  };
  for_particles(near.size(), move, near.threads);
}

template void vorticity(const Neighbourhood<float>&, std::span<Point<float>>);
template void vorticity(const Neighbourhood<double>&, std::span<Point<double>>);
template class VorticityConfinement<float>;
template class VorticityConfinement<double>;

}  // namespace substep::pbf
