#include "substep/gridfluid/particles/move.h"

#include <algorithm>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/gridfluid/grid/sample.h"

namespace substep::gridfluid {
namespace {

constexpr std::int64_t kGrain = 2048;  // particles, whole vectors

template <class Real, int D>
class Mover {
  using V = Vector<Real>;
  using Point = std::array<V, D>;
  static constexpr std::int64_t kLanes = kVectorBytes / static_cast<int>(sizeof(Real));
  static_assert(kLanes <= Particles<Real, D>::kPadding);

 public:
  Mover(Particles<Real, D>& particles, const Layout<D>& layout, const Move<Real, D>& move)
      : particles_(particles), layout_(layout), move_(move), step_(move.dt / move.dx) {}

  // task(packet), each of kLanes particles from one on. What lies behind the last particle is moved
  // too, wherever that is.
  template <class Task>
  void for_packets(const Task& task, int threads) const {
    parallel_for(
        particles_.size(), kGrain,
        [&](std::int64_t begin, std::int64_t end) {
          for (std::int64_t p = begin; p < end; p += kLanes) task(p);
        },
        threads);
  }

  // The first of a packet's particles that is not finite is kept.
  std::int64_t for_packets_checked(const auto& task, int threads) const {
    const std::int64_t n = particles_.size();
    std::vector<std::int64_t> bad(usize((n + kGrain - 1) / kGrain), n);
    for_packets(
        [&](std::int64_t p) {
          const V sum = task(p);
          const auto wrong = ~((sum - sum) == 0);
          if (!any(wrong)) return;
          std::int64_t& first = bad[usize(p / kGrain)];
          for (std::int64_t l = kLanes - 1; l >= 0; --l) {
            if (wrong[l] != 0 && p + l < first) first = std::min(first, p + l);
          }
        },
        threads);
    for (const std::int64_t first : bad) {
      if (first < n) return first;
    }
    return -1;
  }

  SUBSTEP_INLINE Point position(std::int64_t p) const {
    Point x;
    for (int d = 0; d < D; ++d) x[usize(d)] = load<V>(particles_.x(d) + p);
    return x;
  }

  // Sets v and C; returns u(x).
  SUBSTEP_INLINE Point transfer(std::int64_t p, const Point& x) const {
    const Place<V, D> place(in_box(x, 0), layout_);
    Point u;
    for (int c = 0; c < D; ++c) {
      const auto a = usize(c);
      if (move_.transfer == Transfer::kApic) {
        Point gradient;
        u[a] = interpolate<V>(move_.u[a], layout_, c, place, &gradient);
        for (int d = 0; d < D; ++d)
          store(gradient[usize(d)] * (1 / move_.dx), particles_.C(c, d) + p);
        store(u[a], particles_.v(c) + p);
      } else {
        u[a] = interpolate<V>(move_.u[a], layout_, c, place);
        V v = u[a];
        if (move_.transfer == Transfer::kFlip) {
          const V old = interpolate<V>(move_.u_old[a], layout_, c, place);
          const Real ratio = move_.flip_ratio;
          v = ratio * (load<V>(particles_.v(c) + p) + (v - old)) + (1 - ratio) * v;
        }
        store(v, particles_.v(c) + p);
      }
    }
    return u;
  }

  SUBSTEP_INLINE Point velocity(const Point& x) const {
    const Place<V, D> place(in_box(x, 0), layout_);
    Point u;
    for (int c = 0; c < D; ++c) u[usize(c)] = interpolate<V>(move_.u[usize(c)], layout_, c, place);
    return u;
  }

  // Ralston's third order, from k1 = u(x).
  SUBSTEP_INLINE V advect(std::int64_t p, const Point& x, const Point& k1) const {
    const Point k2 = velocity(step(x, k1, step_ / 2));
    const Point k3 = velocity(step(x, k2, step_ * Real(0.75)));
    Point k;
    for (std::size_t d = 0; d < D; ++d) {
      k[d] = Real(2.0 / 9) * k1[d] + Real(3.0 / 9) * k2[d] + Real(4.0 / 9) * k3[d];
    }
    return put(p, step(x, k, step_));
  }
  SUBSTEP_INLINE V displace(std::int64_t p, const Point& x) const {
    return put(p, step(x, velocity(x), 1));
  }

 private:
  static SUBSTEP_INLINE void store(const V& v, Real* to) { std::memcpy(to, &v, sizeof v); }

  static SUBSTEP_INLINE Point step(const Point& x, const Point& k, Real h) {
    Point to;
    for (std::size_t d = 0; d < D; ++d) to[d] = fma<V>(h, k[d], x[d]);
    return to;
  }

  // Through periodic sides, else `margin` from the sides; in the box even where x is NaN.
  SUBSTEP_INLINE Point in_box(Point x, Real margin) const {
    for (std::size_t d = 0; d < D; ++d) {
      const Real n = static_cast<Real>(layout_.cells[d]);
      Real low = margin, high = n - margin;
      if (layout_.periodic[d]) {
        x[d] = x[d] < 0 ? x[d] + n : x[d];
        x[d] = x[d] >= n ? x[d] - n : x[d];
        low = 0, high = n;
      }
      x[d] = x[d] > low ? x[d] : splat<V>(low);
      x[d] = x[d] < high ? x[d] : splat<V>(high);
    }
    return x;
  }

  // Stores a new position where it may be. Returns a number that is finite if it and the velocity
  // are.
  SUBSTEP_INLINE V put(std::int64_t p, Point x) const {
    V sum{};
    for (std::size_t d = 0; d < D; ++d)
      sum += x[d] + load<V>(particles_.v(static_cast<int>(d)) + p);
    x = in_box(x, move_.walls.margin);
    if (move_.walls.solid != nullptr) x = out_of_solid(x);
    for (std::size_t d = 0; d < D; ++d) store(x[d], particles_.x(static_cast<int>(d)) + p);
    return sum;
  }

  // x -= (phi - margin) grad phi / |grad phi|^2 where phi < margin; twice, for where phi bends.
  SUBSTEP_INLINE Point out_of_solid(Point x) const {
    const Real margin = move_.walls.solid_margin;
    for (int pass = 0; pass < 2; ++pass) {
      Point g;
      const V phi = interpolate<V>(move_.walls.solid, layout_, D, Place<V, D>(x, layout_), &g);
      const auto inside = phi < margin;
      if (!any(inside)) break;
      V square{};
      for (std::size_t d = 0; d < D; ++d) square = fma<V>(g[d], g[d], square);
      const V way = inside & (square > 0) ? (margin - phi) / square : V{};
      for (std::size_t d = 0; d < D; ++d) x[d] = fma<V>(way, g[d], x[d]);
      x = in_box(x, move_.walls.margin);
    }
    return x;
  }

  Particles<Real, D>& particles_;
  const Layout<D>& layout_;
  const Move<Real, D>& move_;
  Real step_;  // cells for a velocity of 1 m/s
};

}  // namespace

template <class Real, int D>
void transfer_from_grid(Particles<Real, D>& particles, const Layout<D>& layout,
                        const Move<Real, D>& move, int threads) {
  const Mover<Real, D> mover(particles, layout, move);
  mover.for_packets([&](std::int64_t p) { mover.transfer(p, mover.position(p)); }, threads);
}

template <class Real, int D>
std::int64_t advect(Particles<Real, D>& particles, const Layout<D>& layout,
                    const Move<Real, D>& move, int threads) {
  const Mover<Real, D> mover(particles, layout, move);
  return mover.for_packets_checked(
      [&](std::int64_t p) {
        const auto x = mover.position(p);
        return mover.advect(p, x, mover.velocity(x));
      },
      threads);
}

template <class Real, int D>
std::int64_t transfer_and_advect(Particles<Real, D>& particles, const Layout<D>& layout,
                                 const Move<Real, D>& move, int threads) {
  const Mover<Real, D> mover(particles, layout, move);
  return mover.for_packets_checked(
      [&](std::int64_t p) {
        const auto x = mover.position(p);
        return mover.advect(p, x, mover.transfer(p, x));
      },
      threads);
}

template <class Real, int D>
std::int64_t displace(Particles<Real, D>& particles, const Layout<D>& layout,
                      const ConstFaces<Real, D>& d, const Walls<Real>& walls, int threads) {
  const Move<Real, D> move{.u = d, .walls = walls};
  const Mover<Real, D> mover(particles, layout, move);
  return mover.for_packets_checked(
      [&](std::int64_t p) { return mover.displace(p, mover.position(p)); }, threads);
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                              \
  template void transfer_from_grid(Particles<Real, D>&, const Layout<D>&, const Move<Real, D>&,   \
                                   int);                                                          \
  template std::int64_t advect(Particles<Real, D>&, const Layout<D>&, const Move<Real, D>&, int); \
  template std::int64_t transfer_and_advect(Particles<Real, D>&, const Layout<D>&,                \
                                            const Move<Real, D>&, int);                           \
  template std::int64_t displace(Particles<Real, D>&, const Layout<D>&,                           \
                                 const ConstFaces<Real, D>&, const Walls<Real>&, int);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::gridfluid
