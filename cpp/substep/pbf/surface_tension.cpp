#include "substep/pbf/surface_tension.h"

#include <cmath>

#include "substep/pbf/sums.h"

namespace substep::pbf {
namespace {

template <class Real>
void find_normals(const Neighbourhood<Real>& near, std::span<Point<Real>> normals) {
  using V = Vector<Real>;
  const Real k = near.volume * kernel_scale(near);
  const auto particle = [&](std::int64_t i) {
    V x{}, y{}, z{}, w{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const V g = CubicSpline::slope<V>(pair.q) * pair.inverse_r;
      x = fma<V>(g, pair.x, x);
      y = fma<V>(g, pair.y, y);
      z = fma<V>(g, pair.z, z);
      w += CubicSpline::value<V>(pair.q);
    });
    normals[i] = {k * sum_lanes(x), k * sum_lanes(y), k * sum_lanes(z), k * (sum_lanes(w) + 1)};
  };
  for_particles(near.size(), particle, near.threads);
  normals[near.size()] = {0, 0, 0, 1};
}

}  // namespace

template <class Real>
void SurfaceTension<Real>::displace(const Neighbourhood<Real>& near, double sigma,
                                    double reference_mass, Real factor, std::span<Point<Real>> x) {
  using V = Vector<Real>;
  normals_.resize(near.x.size());
  find_normals<Real>(near, normals_);
  const int d = near.dimension;
  const double tension = sigma / (structure(d) * std::pow(double(near.h), d + 2));
  const Real s = Real((1 - kAreaShare) * tension / cohesion_tension(d));
  const Real a = Real(kAreaShare * tension / area_tension(d));
  const Real k = -2 * factor * near.volume * near.volume / Real(reference_mass);
  const auto particle = [&](std::int64_t i) {
    const Point<Real> ni = normals_[i];
    V fx{}, fy{}, fz{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const PointLanes<V> nj = load_points<V>(normals_.data(), pair.index);
      const V left = positive_part<V>(1 - pair.q), b = left * pair.q;
      const V far = b * b * b;
      const V c = pair.q > Real(0.5) ? far : 2 * far - Real(1) / 64;
      const V bend = ((ni.x - nj.x) * pair.x + (ni.y - nj.y) * pair.y + (ni.z - nj.z) * pair.z) *
                     pair.inverse_r;
      const V f = (s * c + a * left * left * bend) * pair.inverse_r / (ni.w + nj.w);
      fx = fma<V>(f, pair.x, fx);
      fy = fma<V>(f, pair.y, fy);
      fz = fma<V>(f, pair.z, fz);
    });
    const Real ki = k * near.x[i].w;
    x[i].x += ki * sum_lanes(fx);
    x[i].y += ki * sum_lanes(fy);
    x[i].z += ki * sum_lanes(fz);
  };
  for_particles(near.size(), particle, near.threads);
}

template class SurfaceTension<float>;
template class SurfaceTension<double>;

}  // namespace substep::pbf
