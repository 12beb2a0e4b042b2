#include "substep/pbf/density.h"

#include <algorithm>
#include <cmath>

#include "substep/core/parallel.h"
#include "substep/core/point_lanes.h"
#include "substep/core/usize.h"
#include "substep/pbf/kernels.h"

namespace substep::pbf {
namespace {

constexpr double kLeastRelaxation = 1e-9;  // a particle alone has no gradient to divide by

using geometry::NeighbourList;
using geometry::Neighbours;

constexpr std::int64_t kDensityChunk = 1024;  // particles in a chunk

template <class K>
double unit_value(double q) {
  return K::template value<Quad<double>>(splat<Quad<double>>(q))[0];
}
template <class K>
double unit_slope(double q) {
  return K::template slope<Quad<double>>(splat<Quad<double>>(q))[0];
}

// What the kernels of this file read: W = value_scale value(q), v W'/h = slope_scale slope(q).
template <class Real>
struct Scales {
  Real inverse_radius, tiny;
  Real value;  // v s
  Real slope;  // v s' / h
};

// The offset of the points of lanes from x_i, |x_i - x_j|, and 1 / that.
template <class V>
struct Pairs {
  V x, y, z, w, inverse, q;
};

// 1 / sqrt(a); for corrections the estimate of AVX-512 (to 6e-5) will do: both of a pair get the
// same.
enum class Root { kExact, kEstimate };
template <Root root, class V>
SUBSTEP_INLINE V inverse_root(const V& a) {
#ifdef __AVX512F__
  if constexpr (root == Root::kEstimate && sizeof(V) == 64 && sizeof(Lane<V>) == 4) {
    return reinterpret_cast<V>(_mm512_rsqrt14_ps(reinterpret_cast<__m512>(a)));
  }
#endif
  return inverse_sqrt<V>(a);
}

template <class V, Root root = Root::kExact, class Real = Lane<V>>
SUBSTEP_INLINE Pairs<V> load_pairs(const Point<Real>& at, const Point<Real>* points,
                                   const std::int32_t* indices, const Scales<Real>& scales) {
  const PointLanes<V> p = load_points<V>(points, indices);
  const V x = at.x - p.x, y = at.y - p.y, z = at.z - p.z;
  const V r2 = fma(x, x, fma(y, y, fma<V>(z, z, scales.tiny)));
  const V inverse = inverse_root<root, V>(r2);
  return {x, y, z, p.w, inverse, r2 * inverse * scales.inverse_radius};
}

template <class K, class Real>
void sweep_densities(std::span<const Point<Real>> x, const Neighbours<Real>& neighbours,
                     std::span<const Point<Real>> walls, std::span<Real> out,
                     const Scales<Real>& scales, int threads) {
  using V = Vector<Real>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  parallel_for(
      neighbours.size(), kDensityChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          const NeighbourList list = neighbours[i];
          V s{};
          for (std::int32_t at = 0; at < list.count; at += kLanes) {
            s += K::value(load_pairs<V>(x[i], x.data(), list.indices + at, scales).q);
          }
          const auto own = static_cast<Real>(unit_value<K>(0));
          out[i] = scales.value * (sum_lanes<V>(s) + own) + walls[i].w;
        }
      },
      threads);
}

template <class K, class Real>
DensityError sweep_multipliers(std::span<const Point<Real>> x, const Neighbours<Real>& neighbours,
                               std::span<const Point<Real>> walls, std::span<Point<Real>> y,
                               const Scales<Real>& scales, Real relaxation, bool one_sided,
                               int threads, std::span<DensityRow<Real>> parts) {
  using V = Vector<Real>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  const std::int64_t n = neighbours.size();
  std::vector<DensityError> errors(usize((n + kDensityChunk - 1) / kDensityChunk));
  const Real own = static_cast<Real>(unit_value<K>(0));
  parallel_for(
      n, kDensityChunk,
      [&](std::int64_t begin, std::int64_t end) {
        V total{}, worst{};
        for (std::int64_t block = begin; block < end; block += kLanes) {
          const int m = static_cast<int>(std::min<std::int64_t>(kLanes, end - block));
          Point<Real> sums[kLanes] = {};  // of slope n_ij, and of value
          Real squares[kLanes] = {};      // of w_j slope^2
          for (int k = 0; k < m; ++k) {
            const std::int64_t i = block + k;
            const NeighbourList list = neighbours[i];
            PointLanes<V> s{};
            V square{};
            for (std::int32_t at = 0; at < list.count; at += kLanes) {
              const auto p = load_pairs<V>(x[i], x.data(), list.indices + at, scales);
              s.w += K::value(p.q);
              const V g = K::slope(p.q);
              square = fma<V>(g * g, p.w, square);
              const V f = g * p.inverse;
              s.x = fma(f, p.x, s.x);
              s.y = fma(f, p.y, s.y);
              s.z = fma(f, p.z, s.z);
            }
            store_quad(sums[k], sum_points<V>(s));
            squares[k] = sum_lanes<V>(square);
          }
          std::int32_t rows[kLanes];
          for (int k = 0; k < kLanes; ++k) rows[k] = std::min(k, m - 1);
          const auto s = load_points<V>(sums, rows);
          const auto own_x = load_points<V>(x.data() + block, rows);
          const auto wall = load_points<V>(walls.data() + block, rows);
          const V gx = fma<V>(scales.slope, s.x, wall.x), gy = fma<V>(scales.slope, s.y, wall.y),
                  gz = fma<V>(scales.slope, s.z, wall.z);
          const V density = fma<V>(scales.value, s.w + own, wall.w);
          V c = density - 1;
          const V violation = c;
          if (one_sided) c = positive_part<V>(c);
          const V sum_w = fma<V>(own_x.w, fma(gx, gx, fma<V>(gy, gy, gz * gz)),
                                 scales.slope * scales.slope * load<V>(squares));
          const V scale = sum_w + relaxation, lambda = -c / scale;
          for (int k = 0; k < m; ++k) {
            const Point<Real>& from = x[block + k];
            y[block + k] = {from.x, from.y, from.z, lambda[k]};
          }
          for (int k = 0; k < m && !parts.empty(); ++k) {
            parts[block + k] = {violation[k], scale[k]};
          }
          for (int k = m; k < kLanes; ++k) c[k] = 0;
          const V error = c < 0 ? -c : c;
          total += error;
          worst = error > worst ? error : worst;
        }
        DensityError& error = errors[begin / kDensityChunk];
        for (int k = 0; k < kLanes; ++k) {
          error.mean += static_cast<double>(total[k]);
          error.max = std::max(error.max, static_cast<double>(worst[k]));
        }
      },
      threads);
  DensityError all;
  for (const DensityError& error : errors) {
    all.mean += error.mean;
    all.max = std::max(all.max, error.max);
  }
  if (n > 0) all.mean /= static_cast<double>(n);
  return all;
}

template <class K, bool kArtificialPressure, class Real>
std::int64_t sweep_corrections(std::span<const Point<Real>> y, const Neighbours<Real>& neighbours,
                               std::span<const Point<Real>> walls, std::span<Point<Real>> x,
                               std::span<Point<Real>> sums, const Scales<Real>& scales,
                               Real artificial_pressure, Real limit, int threads) {
  using V = Vector<Real>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  const std::int64_t n = neighbours.size();
  std::vector<std::int64_t> limited(usize((n + kDensityChunk - 1) / kDensityChunk));
  parallel_for(
      n, kDensityChunk,
      [&](std::int64_t begin, std::int64_t end) {
        std::int64_t count = 0;
        for (std::int64_t i = begin; i < end; ++i) {
          const Point<Real> at = y[i];
          const NeighbourList list = neighbours[i];
          PointLanes<V> s{};
          for (std::int32_t from = 0; from < list.count; from += kLanes) {
            const auto p =
                load_pairs<V, Root::kEstimate>(at, y.data(), list.indices + from, scales);
            V pressure = at.w + p.w;
            if constexpr (kArtificialPressure) {
              const V u = K::value(p.q), u2 = u * u;
              pressure -= artificial_pressure * (u2 * u2);
            }
            const V f = K::slope(p.q) * p.inverse * pressure;
            s.x = fma(f, p.x, s.x);
            s.y = fma(f, p.y, s.y);
            s.z = fma(f, p.z, s.z);
          }
          const Quad<Real> g = sum_points<V>(s);
          const Quad<Real> wall = load_quad(walls[i]);
          const Real w = x[i].w;
          Quad<Real> dx = w * (scales.slope * g + at.w * wall);
          dx[3] = 0;
          const Real length2 = dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2];
          if (length2 > limit * limit) {
            dx *= limit / std::sqrt(length2);
            ++count;
          }
          Quad<Real> moved = load_quad(y[i]) + dx;
          moved[3] = w;
          store_quad(x[i], moved);
          sums[i].w += at.w;
        }
        limited[begin / kDensityChunk] = count;
      },
      threads);
  std::int64_t all = 0;
  for (const std::int64_t count : limited) all += count;
  return all;
}

}  // namespace

template <class Real>
template <class Visit>
void DensityConstraint<Real>::for_kernel(Visit&& visit) const {
  if (options_.kernel == Kernel::kCubicSpline) {
    visit(CubicSpline{});
  } else {
    visit(Poly6Spiky{});
  }
}

template <class Real>
DensityConstraint<Real>::DensityConstraint(const DensityOptions& options)
    : options_(options),
      radius_(options.support * options.spacing),
      power_(std::pow(radius_, options.dimension)),
      volume_(1),
      gradient_sum_(0),
      half_lattice_(0) {
  // Sums over the lattice; those of the gradients themselves vanish by symmetry.
  const int reach = static_cast<int>(options.support) + 1,
            deep = options.dimension == 2 ? 0 : reach;
  double density = 0, half = 0;
  for (int a = -reach; a <= reach; ++a) {
    for (int b = -reach; b <= reach; ++b) {
      for (int c = -deep; c <= deep; ++c) {
        const double r = options.spacing * std::sqrt(a * a + b * b + c * c);
        density += value(r);
        if (a > 0) half += value(r);
        if (r > 0) gradient_sum_ += slope(r) * slope(r);
      }
    }
  }
  volume_ = 1 / density;
  half_lattice_ = volume_ * half;
  gradient_sum_ *= volume_ * volume_;
}

template <class Real>
double DensityConstraint<Real>::value(double r) const {
  double result = 0;
  for_kernel([&]<class K>(K) {
    result = K::value_scale(options_.dimension) / power_ * unit_value<K>(r / radius_);
  });
  return result;
}

template <class Real>
double DensityConstraint<Real>::slope(double r) const {
  double result = 0;
  for_kernel([&]<class K>(K) {
    result = K::slope_scale(options_.dimension) / (power_ * radius_) * unit_slope<K>(r / radius_);
  });
  return result;
}

template <class Real>
Point<Real> DensityConstraint<Real>::far_point() const {
  const auto far =
      static_cast<Real>(std::is_same_v<Real, float> ? 0x1p26 * radius_ : 0x1p55 * radius_);
  return {far, far, far, 0};
}

namespace {

template <class K, class Real>
Scales<Real> scales_of(const DensityOptions& options, double radius, double volume) {
  const double power = std::pow(radius, options.dimension);
  return {static_cast<Real>(1 / radius), static_cast<Real>(1e-12 * radius * radius),
          static_cast<Real>(volume * K::value_scale(options.dimension) / power),
          static_cast<Real>(volume * K::slope_scale(options.dimension) / (power * radius))};
}

}  // namespace

template <class Real>
void DensityConstraint<Real>::densities(std::span<const Point<Real>> x,
                                        const Neighbours<Real>& neighbours,
                                        std::span<const Point<Real>> walls, std::span<Real> out,
                                        int threads) const {
  for_kernel([&]<class K>(K) {
    sweep_densities<K>(x, neighbours, walls, out, scales_of<K, Real>(options_, radius_, volume_),
                       threads);
  });
}

template <class Real>
DensityError DensityConstraint<Real>::multipliers(std::span<const Point<Real>> x,
                                                  const Neighbours<Real>& neighbours,
                                                  std::span<const Point<Real>> walls,
                                                  std::span<Point<Real>> y, int threads,
                                                  std::span<DensityRow<Real>> parts) const {
  DensityError error;
  for_kernel([&]<class K>(K) {
    error = sweep_multipliers<K>(
        x, neighbours, walls, y, scales_of<K, Real>(options_, radius_, volume_),
        static_cast<Real>(std::max(options_.relaxation, kLeastRelaxation) * gradient_sum_),
        options_.one_sided, threads, parts);
  });
  return error;
}

template <class Real>
std::int64_t DensityConstraint<Real>::correct(std::span<const Point<Real>> y,
                                              const Neighbours<Real>& neighbours,
                                              std::span<const Point<Real>> walls,
                                              std::span<Point<Real>> x, std::span<Point<Real>> sums,
                                              int threads) const {
  std::int64_t limited = 0;
  for_kernel([&]<class K>(K) {
    const auto scales = scales_of<K, Real>(options_, radius_, volume_);
    const auto limit = static_cast<Real>(radius_ / 4);
    const double reference = std::pow(unit_value<K>(0.2), 4);
    const auto pressure =
        static_cast<Real>(options_.artificial_pressure / gradient_sum_ / reference);
    limited = pressure > 0 ? sweep_corrections<K, true>(y, neighbours, walls, x, sums, scales,
                                                        pressure, limit, threads)
                           : sweep_corrections<K, false>(y, neighbours, walls, x, sums, scales,
                                                         pressure, limit, threads);
  });
  return limited;
}

template class DensityConstraint<float>;
template class DensityConstraint<double>;

}  // namespace substep::pbf
