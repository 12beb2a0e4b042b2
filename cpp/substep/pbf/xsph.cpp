#include "substep/pbf/xsph.h"

#include "substep/pbf/sums.h"

namespace substep::pbf {

template <class Real>
void xsph(const Neighbourhood<Real>& near, Real c, std::span<Point<Real>> v_new) {
  using V = Vector<Real>;
  const Real k = 2 * c * near.volume * kernel_scale(near);
  const auto particle = [&](std::int64_t i) {
    const Point<Real> vi = near.v[i];
    const Real wi = near.x[i].w;
    V x{}, y{}, z{};
    for_pairs<V>(near, i, [&](const PairLanes<V>& pair) {
      const PointLanes<V> vj = load_points<V>(near.v.data(), pair.index);
      const V weight = wi / (wi + pair.inverse_mass) * CubicSpline::value<V>(pair.q);
      x = fma<V>(weight, vj.x - vi.x, x);
      y = fma<V>(weight, vj.y - vi.y, y);
      z = fma<V>(weight, vj.z - vi.z, z);
    });
    v_new[i] = {vi.x + k * sum_lanes(x), vi.y + k * sum_lanes(y), vi.z + k * sum_lanes(z), vi.w};
  };
  for_particles(near.size(), particle, near.threads);
  v_new[near.size()] = near.v[near.size()];
}

template void xsph(const Neighbourhood<float>&, float, std::span<Point<float>>);
template void xsph(const Neighbourhood<double>&, double, std::span<Point<double>>);

}  // namespace substep::pbf
