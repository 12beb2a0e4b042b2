// Projects constraints that are formulas (constraint.h), as many at once as a vector has lanes.
// For each constraint j (XPBD: Macklin, Mueller, Chentanez 2016, eq. 18 and 26)
//
//   dlambda = (-C - a lambda - g grad C . (x - x_old)) / ((1 + g) sum_i w_i |grad_i C|^2 + a)
//   x_i += w_i grad_i C dlambda,   lambda += dlambda,
//   a = alpha / h^2, g = alpha beta / h,
//
// with compliance alpha, damping beta, and x_old the positions at the start of the substep. Plain
// PBD is a = g = 0 and dlambda scaled by 1 - (1 - k)^(1/n), so that a part 1 - k of the error is
// left after the n projections of a step (Mueller et al. 2007, section 3.3).
//
// Jacobi splits the mass of a particle that n_i constraints hold in n_i parts, which each see n_i
// w_i and are joined at their mean (Tonge, Benevolenski, Voroshilov 2012): all corrections of one
// iteration together do not overshoot, momentum is kept, and lambda stays the multiplier of what
// was moved. `relaxation` scales dlambda.
#pragma once

#include <array>
#include <cstring>
#include <utility>

#include "substep/core/matrix3.h"
#include "substep/core/point_scatter.h"
#include "substep/pbd/constraints/constraint.h"
#include "substep/pbd/groups/kernels.h"

namespace substep::pbd {

// body(0), body(1), ... with numbers known to the compiler, so that arrays of lanes stay in
// registers.
template <std::size_t kCount, class Body>
SUBSTEP_INLINE void unrolled(const Body& body) {
  const auto all = [&]<std::size_t... i>(std::index_sequence<i...>) __attribute__((always_inline)) {
    (body(std::integral_constant<std::size_t, i>{}), ...);
  };
  all(std::make_index_sequence<kCount>{});
}

template <class Constraint, class Real>
struct Projection {
  static constexpr std::size_t kPoints = Constraint::kPoints;
  static constexpr std::size_t kParameters = Constraint::kParameters;
  using V = Vector<Real>;
  using Softness = LaneSoftness<Real>;
  static constexpr std::size_t kLanes = Kernels<Real>::kLanes;
  static constexpr std::int64_t kUnits = Kernels<Real>::kUnits;

  static Point<Real>* row(Point<Real>* x, std::uint32_t place) {
    return reinterpret_cast<Point<Real>*>(reinterpret_cast<std::int64_t*>(x) + place);
  }
  static const Point<Real>* row(const Point<Real>* x, std::uint32_t place) {
    return reinterpret_cast<const Point<Real>*>(reinterpret_cast<const std::int64_t*>(x) + place);
  }
  // kernels.h
  struct alignas(kVectorBytes) Block {
    std::uint32_t place[kPoints][kLanes];
    Real parameter[kParameters > 0 ? kParameters : 1][kLanes];
  };
  static_assert(sizeof(Block) == Kernels<Real>::lines(kPoints, kParameters) * kVectorBytes);
  static constexpr std::size_t kAhead = 12;  // blocks between fetching and use

  // As a group sees them, which knows of no constraint.
  static constexpr Kernels<Real> kernels() {
    return {kPoints, kParameters, Constraint::kInequality, &project, &correct, &values};
  }

  // What one block comes to at the present positions.
  struct Evaluation {
    std::array<PointLanes<V>, kPoints> p;
    std::array<Lanes3<V>, kPoints> gradient;
    V c;
  };
  SUBSTEP_INLINE static void evaluate(const Block& block, const Point<Real>* x, Evaluation& e) {
    std::array<Lanes3<V>, kPoints> at;
    unrolled<kPoints>([&](auto i) __attribute__((always_inline)) {
      e.p[i] = load_rows<V>([&](int lane) { return row(x, block.place[i][lane]); });
      at[i] = {e.p[i].x, e.p[i].y, e.p[i].z};
    });
    std::array<V, kParameters> parameters;
    unrolled<kParameters>([&](auto i) __attribute__((always_inline)) {
      parameters[i] = substep::load<V>(block.parameter[i]);
    });
    Constraint::template evaluate<V>(at, parameters, e.c, e.gradient);
  }

  // dlambda of block b where the constraints see the inverse masses w; lambda is kept up. Lanes
  // without gradients are 0 and counted.
  template <Softening kSoftening>
  SUBSTEP_INLINE static V update(const Block* blocks, std::size_t b, const Sweep<Real>& s,
                                 const Softness& soft, const std::array<V, kPoints>& w,
                                 Real relaxation, const Evaluation& e, std::int64_t& skipped) {
    V squares{}, weight{};
    unrolled<kPoints>([&](auto i) __attribute__((always_inline)) {
      const V square = square_of(e.gradient[i]);
      squares += square;
      weight = fma<V>(w[i], square, weight);
    });
    V wanted = -e.c, lambda{};
    if (soft.resume) lambda = substep::load<V>(soft.multiplier[b].values);
    auto active = kSoftening == Softening::rigid ? weight > 0 : squares > 0;
    if constexpr (kSoftening != Softening::rigid) {
      const V a = soft.compliance[b] * static_cast<Real>(1 / (s.h * s.h));
      wanted -= a * lambda;
      if constexpr (kSoftening == Softening::damped) {
        const V g = a * soft.damping[b] * static_cast<Real>(s.h);
        wanted -= g * approach(blocks[b], s.x_old, e);
        weight = fma<V>(g, weight, weight);
      }
      weight += a;
      active &= weight > 0;
    }
    if (any(~active)) [[unlikely]]
      skipped += count_flat(blocks[b], s);
    if constexpr (Constraint::kInequality) active &= e.c < 0;
    V dlambda = active ? wanted / (active ? weight : splat<V>(1)) : V{};
    dlambda *= soft.stiffness[b] * relaxation;
    if constexpr (Constraint::kInequality) {
      dlambda = dlambda < -lambda ? -lambda : dlambda;  // it never pulls
    }
    if (soft.multiplier) {
      const V sum = lambda + dlambda;
      std::memcpy(soft.multiplier[b].values, &sum, sizeof sum);
    }
    return dlambda;
  }

  // Gauss-Seidel: blocks [begin, end), each moving its particles. Returns how many constraints had
  // no gradient.
  static std::int64_t project(const void* blocks, std::size_t begin, std::size_t end,
                              const Sweep<Real>& s, const Softness& soft) {
    return with_softening(soft, [&]<Softening kSoftening>() {
      return project<kSoftening>(static_cast<const Block*>(blocks), begin, end, s, soft);
    });
  }
  template <Softening kSoftening>
  static std::int64_t project(const Block* blocks, std::size_t begin, std::size_t end,
                              const Sweep<Real>& s, const Softness& soft) {
    std::int64_t skipped = 0;
    for (std::size_t b = begin; b < end; ++b) {
      for (std::size_t line = 0; line < sizeof(Block); line += 64) {
        __builtin_prefetch(reinterpret_cast<const char*>(blocks + b + kAhead) + line);
      }
      if (full(blocks[b], s)) [[likely]] {
        Evaluation e;
        evaluate(blocks[b], s.x, e);
        const std::array<V, kPoints> w = inverse_masses(e);
        move(update<kSoftening>(blocks, b, s, soft, w, Real{1}, e, skipped), w, e);
        unrolled<kPoints>([&](auto i) __attribute__((always_inline)) {
          store_rows<V>(e.p[i], [&](int lane) { return row(s.x, blocks[b].place[i][lane]); });
        });
      } else {
        project_some(blocks, b, s, soft, skipped);
      }
    }
    return skipped;
  }

  // Jacobi: rows[(kPoints b + i) kLanes + lane] is what moves particle i of a constraint.
  static std::int64_t correct(const void* blocks, std::size_t begin, std::size_t end,
                              const Sweep<Real>& s, const Softness& soft, Point<Real>* rows) {
    return with_softening(soft, [&]<Softening kSoftening>() {
      return correct<kSoftening>(static_cast<const Block*>(blocks), begin, end, s, soft, rows);
    });
  }
  template <Softening kSoftening>
  static std::int64_t correct(const Block* blocks, std::size_t begin, std::size_t end,
                              const Sweep<Real>& s, const Softness& soft, Point<Real>* rows) {
    std::int64_t skipped = 0;
    for (std::size_t b = begin; b < end; ++b) {
      Evaluation e;
      evaluate(blocks[b], s.x, e);
      std::array<V, kPoints> w;
      for (std::size_t i = 0; i < kPoints; ++i) {
        for (std::size_t lane = 0; lane < kLanes; ++lane) {
          const auto particle = blocks[b].place[i][lane] / kUnits;
          w[i][lane] = e.p[i].w[lane] * static_cast<Real>(s.splits[particle]);
        }
      }
      const V dlambda =
          update<kSoftening>(blocks, b, s, soft, w, static_cast<Real>(s.relaxation), e, skipped);
      for (std::size_t i = 0; i < kPoints; ++i) {
        const V scale = dlambda * e.p[i].w;
        const Lanes3<V>& g = e.gradient[i];
        Point<Real>* const out = rows + (b * kPoints + i) * kLanes;
        store_rows<V>({g.x * scale, g.y * scale, g.z * scale, V{}},
                      [&](int lane) { return out + lane; });
      }
    }
    return skipped;
  }

  // C of the lanes of a block.
  static void values(const void* block, const Point<Real>* x, Real* c) {
    const Evaluation e = evaluated(*static_cast<const Block*>(block), x);
    std::memcpy(c, &e.c, sizeof e.c);
  }

 private:
  // grad C . (x - x_old): how far C has come in this substep.
  SUBSTEP_INLINE static V approach(const Block& block, const Point<Real>* x_old,
                                   const Evaluation& e) {
    V sum{};
    unrolled<kPoints>([&](auto i) __attribute__((always_inline)) {
      const auto old = load_rows<V>([&](int lane) { return row(x_old, block.place[i][lane]); });
      sum = fma<V>(e.gradient[i].x, e.p[i].x - old.x, sum);
      sum = fma<V>(e.gradient[i].y, e.p[i].y - old.y, sum);
      sum = fma<V>(e.gradient[i].z, e.p[i].z - old.z, sum);
    });
    return sum;
  }

  SUBSTEP_INLINE static V square_of(const Lanes3<V>& g) {
    return fma<V>(g.x, g.x, fma<V>(g.y, g.y, g.z * g.z));
  }
  SUBSTEP_INLINE static bool full(const Block& block, const Sweep<Real>& s) {
    return block.place[0][kLanes - 1] < s.count * kUnits;
  }

  template <class Function>
  SUBSTEP_INLINE static auto with_softening(const Softness& soft, const Function& function) {
    switch (soft.softening) {
      case Softening::rigid:
        return function.template operator()<Softening::rigid>();
      case Softening::soft:
        return function.template operator()<Softening::soft>();
      default:
        return function.template operator()<Softening::damped>();
    }
  }

  SUBSTEP_INLINE static std::array<V, kPoints> inverse_masses(const Evaluation& e) {
    std::array<V, kPoints> w;
    unrolled<kPoints>([&](auto i) __attribute__((always_inline)) { w[i] = e.p[i].w; });
    return w;
  }

  // Particles of a block where the constraints want them, in e.
  SUBSTEP_INLINE static void move(const V& dlambda, const std::array<V, kPoints>& w,
                                  Evaluation& e) {
    unrolled<kPoints>([&](auto i) __attribute__((always_inline)) {
      const V scale = dlambda * w[i];
      e.p[i].x = fma<V>(e.gradient[i].x, scale, e.p[i].x);
      e.p[i].y = fma<V>(e.gradient[i].y, scale, e.p[i].y);
      e.p[i].z = fma<V>(e.gradient[i].z, scale, e.p[i].z);
    });
  }

  // A block that is not full: the empty particle is everyone's, and nobody writes it.
  [[gnu::noinline]] static void project_some(const Block* blocks, std::size_t b,
                                             const Sweep<Real>& s, const Softness& soft,
                                             std::int64_t& skipped) {
    Evaluation e = evaluated(blocks[b], s.x);
    const std::array<V, kPoints> w = inverse_masses(e);
    const V dlambda = with_softening(soft, [&]<Softening kSoftening>() {
      return update<kSoftening>(blocks, b, s, soft, w, Real{1}, e, skipped);
    });
    move(dlambda, w, e);
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      if (blocks[b].place[0][lane] >= s.count * kUnits) break;
      for (std::size_t i = 0; i < kPoints; ++i) {
        const auto& [x, y, z, w_i] = e.p[i];
        *row(s.x, blocks[b].place[i][lane]) = {x[lane], y[lane], z[lane], w_i[lane]};
      }
    }
  }

  // Where it is rarely needed.
  [[gnu::noinline]] static Evaluation evaluated(const Block& block, const Point<Real>* x) {
    Evaluation e;
    evaluate(block, x, e);
    return e;
  }

  // How many constraints of a block have no gradient and are not satisfied.
  [[gnu::noinline]] static std::int64_t count_flat(const Block& block, const Sweep<Real>& s) {
    const Evaluation e = evaluated(block, s.x);
    V squares{};
    for (const auto& g : e.gradient) squares += square_of(g);
    std::int64_t count = 0;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      if (block.place[0][lane] >= s.count * kUnits) break;
      const bool satisfied = Constraint::kInequality ? e.c[lane] >= 0 : e.c[lane] == 0;
      count += squares[lane] == 0 && !satisfied;
    }
    return count;
  }
};

}  // namespace substep::pbd
