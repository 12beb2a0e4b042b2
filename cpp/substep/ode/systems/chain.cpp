#include "substep/ode/systems/chain.h"

#include <utility>

#include "substep/core/tableau.h"
#include "substep/core/usize.h"
#include "substep/ode/stepping/combine.h"
#include "substep/ode/symplectic/symplectic.h"
#include "substep/ode/systems/chain_tiles.h"

namespace substep::ode {
namespace {

struct UniformForce {
  double k_over_m;
  // The force on cell i of x, divided by its mass; x is given from cell `origin` of the chain on.
  double operator()(const double* x, std::int64_t i, std::int64_t /*origin*/) const {
    return k_over_m * ((x[i + 1] - x[i]) - (x[i] - x[i - 1]));
  }
};

struct VaryingForce {
  const double *k, *inverse_mass;
  double operator()(const double* x, std::int64_t i, std::int64_t origin) const {
    const double *ki = k + origin, *mi = inverse_mass + origin;
    return (ki[i + 1] * (x[i + 1] - x[i]) - ki[i] * (x[i] - x[i - 1])) * mi[i];
  }
};

// The cells beyond the ends. At a cut any value will do: it reaches halo cells only.
struct Ends {
  bool fixed;
  void operator()(const Tile& tile, double* x) const {
    x[-1] = tile.left_end && !fixed ? x[0] : 0;
    x[tile.size] = tile.right_end && !fixed ? x[tile.size - 1] : 0;
  }
};

// The steps below do what runge_kutta.h and symplectic.cpp do, operation for operation, so they
// give the same bits; passes over the tile are merged where the force allows.

// Whether stages use the stage before only: k_i = f(y + h a_{i,i-1} k_{i-1}).
template <class T>
inline constexpr bool kOneStageBack = [] {
  for (int i = 0; i < T::stages; ++i) {
    for (int j = 0; j + 1 < i; ++j) {
      if (T::a[i][j] != 0) return false;
    }
  }
  return true;
}();

template <class T, class Force>
class RungeKuttaTile {
 public:
  static constexpr std::int64_t kReach = T::stages;  // cells that a step spoils at a cut
  RungeKuttaTile(double h, Force force, Ends ends) : h_(h), force_(force), ends_(ends) {}

  void operator()(Tile& tile, std::int64_t steps) {
    tile_ = &tile;
    for (std::int64_t s = 0; s < steps; ++s) stage<0>(tile.x, tile.v);
  }

 private:
  // Stage S at position p and velocity q: k_S = (q, a(p)). Adds b_S k_S to the sums, and leaves the
  // next stage's position in another array (a(p) reads the neighbours) and its velocity in q. The
  // last stage is added to the step by itself, as increment() of combine.h does.
  template <int S>
  void stage(double* __restrict p, const double* q) {
    constexpr bool last = S == T::stages - 1;
    constexpr double weight = T::b[S];
    constexpr bool first_term = last_nonzero<WeightRow<T>>(S) < 0;
    const std::int64_t size = tile_->size, origin = tile_->origin;
    double *x = tile_->x, *v = tile_->v, *sum_x = sum_x_.data(), *sum_v = sum_v_.data();
    double *next_p = (S % 2 ? p1_ : p0_).data(), *next_q = q_.data();
    const Force force = force_;
    const double h = h_;
    double next = 0;
    if constexpr (!last) next = h * T::a[S + 1][S];
    ends_(*tile_, p);
#pragma GCC ivdep
    for (std::int64_t i = 0; i < size; ++i) {
      const double a = force(p, i, origin), qi = q[i];
      if constexpr (last) {
        double xi = x[i], vi = v[i];
        if constexpr (!first_term) {
          xi = multiply_add(h, sum_x[i], xi);
          vi = multiply_add(h, sum_v[i], vi);
        }
        next_p[i] = multiply_add(h * weight, qi, xi);
        v[i] = multiply_add(h * weight, a, vi);
      } else {
        if constexpr (weight != 0 && first_term) {
          sum_x[i] = weight * qi;
          sum_v[i] = weight * a;
        } else if constexpr (weight != 0) {
          sum_x[i] = multiply_add(weight, qi, sum_x[i]);
          sum_v[i] = multiply_add(weight, a, sum_v[i]);
        }
        next_p[i] = multiply_add(next, qi, x[i]);
        next_q[i] = multiply_add(next, a, v[i]);
      }
    }
    if constexpr (last) {
      std::copy_n(next_p, size, x);
    } else {
      stage<S + 1>(next_p, next_q);
    }
  }

  double h_;
  Force force_;
  Ends ends_;
  Tile* tile_ = nullptr;
  TileArray p0_, p1_, q_, sum_x_, sum_v_;  // live for a whole chunk
};

// Kick and drift with one force: v += g a(x), x += s v, for symplectic Euler (g = s = h) and
// position Verlet (g = h^2, s = 1, on increments).
template <class Force>
class KickDriftTile {
 public:
  static constexpr std::int64_t kReach = 1;
  KickDriftTile(double kick, double drift, Force force, Ends ends)
      : kick_(kick), drift_(drift), force_(force), ends_(ends) {}

  void operator()(Tile& tile, std::int64_t steps) {
    double *x = tile.x, *v = tile.v, *next_x = next_.data();
    const Force force = force_;
    const double kick = kick_, drift = drift_;
    for (std::int64_t s = 0; s < steps; ++s) {
      ends_(tile, x);
#pragma GCC ivdep
      for (std::int64_t i = 0; i < tile.size; ++i) {
        v[i] = multiply_add(kick, force(x, i, tile.origin), v[i]);
        next_x[i] = multiply_add(drift, v[i], x[i]);
      }
      std::swap(x, next_x);
    }
    tile.x = x;
  }

 private:
  double kick_, drift_;
  Force force_;
  Ends ends_;
  TileArray next_;
};

// Velocity Verlet with the steps weight * h. The half kick that ends a step and the one that begins
// the next have the same force, and one pass does both and the drift.
template <class Force>
class VerletTile {
 public:
  VerletTile(double h, std::span<const double> weights, Force force, Ends ends)
      : h_(h), weights_(weights), force_(force), ends_(ends) {}

  void operator()(Tile& tile, std::int64_t steps) {
    double *x = tile.x, *v = tile.v, *next_x = next_.data();
    const auto kicks = static_cast<std::int64_t>(weights_.size()) * steps;
    double before = 0;  // the step that ends with this force
    for (std::int64_t kick = 0; kick <= kicks; ++kick) {
      const double after = kick < kicks ? h_ * weights_[kick % weights_.size()] : 0;
      ends_(tile, x);
      if (kick == 0) {
        pass<false, true>(tile, x, v, next_x, before, after);
      } else if (kick < kicks) {
        pass<true, true>(tile, x, v, next_x, before, after);
      } else {
        pass<true, false>(tile, x, v, next_x, before, after);
        break;
      }
      std::swap(x, next_x);
      before = after;
    }
    tile.x = x;
  }

 private:
  template <bool ends_step, bool begins_step>
  void pass(const Tile& tile, const double* x, double* v, double* next_x, double before,
            double after) const {
    const Force force = force_;
#pragma GCC ivdep
    for (std::int64_t i = 0; i < tile.size; ++i) {
      const double a = force(x, i, tile.origin);
      double vi = v[i];
      if constexpr (ends_step) vi = multiply_add(before / 2, a, vi);
      if constexpr (begins_step) {
        vi = multiply_add(after / 2, a, vi);
        next_x[i] = multiply_add(after, vi, x[i]);
      }
      v[i] = vi;
    }
  }

  double h_;
  std::span<const double> weights_;
  Force force_;
  Ends ends_;
  TileArray next_;
};

// `steps` steps, as many per sweep as the halo allows: a step spoils `reach` cells at a cut, the
// whole sweep `extra` more.
template <class MakeTile>
void run_tiles(std::int64_t n, const FixedRun& run, std::int64_t reach, std::int64_t extra,
               MakeTile&& make_tile) {
  ChainSweep sweep(n, run.y, run.y + n, run.threads);
  const std::int64_t together = (kHalo - extra) / reach;
  for (std::int64_t done = 0; done < run.steps; done += together) {
    const std::int64_t steps = std::min(together, run.steps - done);
    sweep(steps * reach + extra, steps, make_tile);
  }
}

template <class Force>
bool run_fixed(std::int64_t n, const FixedRun& run, Force force, Ends ends) {
  const double h = run.h;
  bool done = false;
  for_each_method<FixedMethods>([&]<class T>(const T&) {
    if constexpr (kOneStageBack<T>) {
      if (run.method != T::name) return;
      using Kernel = RungeKuttaTile<T, Force>;
      run_tiles(n, run, Kernel::kReach, 0, [&] { return Kernel(h, force, ends); });
      done = true;
    }
  });
  if (done) return true;
  const int method = symplectic_method(run.method);
  if (method < 0) return false;
  const std::span<const double> weights = verlet_weights(method);
  if (method == kSymplecticEuler) {
    run_tiles(n, run, 1, 0, [&] { return KickDriftTile<Force>(h, h, force, ends); });
  } else if (method == kPositionVerlet) {
    run_tiles(n, run, 1, 0, [&] { return KickDriftTile<Force>(h * h, 1, force, ends); });
  } else {
    run_tiles(n, run, static_cast<std::int64_t>(weights.size()), 1,
              [&] { return VerletTile<Force>(h, weights, force, ends); });
  }
  return true;
}

}  // namespace

SpringChain::SpringChain(std::int64_t n, std::vector<double> k, std::vector<double> m,
                         bool fixed_ends)
    : n_(n), uniform_(k.size() == 1 && m.size() == 1), fixed_ends_(fixed_ends) {
  const auto expand = [](std::vector<double>& values, std::int64_t count) {
    if (values.size() == 1) values.resize(usize(count), values[0]);
    if (static_cast<std::int64_t>(values.size()) != count) {
      throw InputError("spring_chain: expected n + 1 springs and n masses, or one of either");
    }
  };
  if (uniform_) {
    k_over_m_ = k[0] / m[0];
    return;
  }
  expand(k, n + 1);
  expand(m, n);
  for (double& mass : m) mass = 1 / mass;
  k_ = std::move(k);
  inverse_mass_ = std::move(m);
}

template <class Use>
auto SpringChain::with_force(Use&& use) const {
  if (uniform_) return use(UniformForce{k_over_m_});
  return use(VaryingForce{k_.data(), inverse_mass_.data()});
}

void SpringChain::rhs(double t, const double* y, double* dydt) {
  std::copy_n(y + n_, n_, dydt);
  acceleration(t, y, y + n_, dydt + n_);
}

void SpringChain::acceleration(double, const double* x, const double*, double* a) {
  if (n_ == 0) return;
  with_force([&](auto force) {
    parallel_for(n_, 16384, [&](std::int64_t begin, std::int64_t end) {
      const std::int64_t last = std::min(end, n_ - 1);
      for (std::int64_t i = std::max<std::int64_t>(begin, 1); i < last; ++i) a[i] = force(x, i, 0);
    });
    // The ends, with the cell beyond.
    for (const std::int64_t i : {std::int64_t{0}, n_ - 1}) {
      const double wall = fixed_ends_ ? 0 : x[i];
      const double around[3] = {i > 0 ? x[i - 1] : wall, x[i], i < n_ - 1 ? x[i + 1] : wall};
      a[i] = force(around, 1, i - 1);
    }
  });
}

bool SpringChain::fixed_steps(const FixedRun& run) {
  const Ends ends{fixed_ends_};
  if (!with_force([&](auto force) { return run_fixed(n_, run, force, ends); })) return false;
  if (run.a != nullptr) acceleration(0, run.y, nullptr, run.a);
  return true;
}

}  // namespace substep::ode
