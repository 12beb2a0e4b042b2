#include "substep/ode/symplectic/symplectic_solve.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/interrupt.h"

namespace substep::ode {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// The times of the steps: t0 + k h for k < steps, then t1.
class StepGrid {
 public:
  StepGrid(double t0, double t1, double step) : t0_(t0), t1_(t1), h_(t1 < t0 ? -step : step) {
    if (t0 == t1 || too_fine()) return;
    // A last step that rounding alone would add is not taken.
    const double count = (t1 - t0) / h_;
    full_ = static_cast<std::int64_t>(std::floor(count * (1 + 4 * kEps)));
    const double rest = std::abs(t1 - (t0 + static_cast<double>(full_) * h_));
    const double spacing = kEps * std::max(std::abs(t0), std::abs(t1));
    const bool cut = rest > std::max(4 * spacing, full_ > 0 ? 1e-12 * step : 0.0);
    steps_ = full_ + (cut || full_ == 0 ? 1 : 0);
  }

  // A step below the spacing of the floating-point numbers around t.
  bool too_fine() const { return t0_ != t1_ && (t0_ + h_ == t0_ || t1_ - h_ == t1_); }
  std::int64_t steps() const { return steps_; }
  std::int64_t full_steps() const { return full_; }
  double h(std::int64_t k) const { return k < full_ ? h_ : t1_ - time(k); }
  double time(std::int64_t k) const {
    return k == steps_ ? t1_ : t0_ + static_cast<double>(k) * h_;
  }
  bool before(double a, double b) const { return h_ > 0 ? a < b : a > b; }

  // The last step time that is not after t.
  std::int64_t index_before(double t) const {
    auto k = static_cast<std::int64_t>(std::floor((t - t0_) / h_));
    k = std::clamp<std::int64_t>(k, 0, steps_);
    while (k > 0 && before(t, time(k))) --k;
    while (k < steps_ && !before(t, time(k + 1))) ++k;
    return k;
  }

 private:
  double t0_, t1_, h_;
  std::int64_t full_ = 0, steps_ = 0;
};

// Cubic Hermite interpolation at theta h, Hairer, Norsett, Wanner, "Solving Ordinary Differential
// Equations I", II.6 (6.7): values p, slopes m at 0 and h.
void hermite(std::int64_t n, double theta, double h, const double* p0, const double* m0,
             const double* p1, const double* m1, double* out) {
  for (std::int64_t i = 0; i < n; ++i) {
    out[i] = (1 - theta) * p0[i] + theta * p1[i] +
             theta * (theta - 1) *
                 ((1 - 2 * theta) * (p1[i] - p0[i]) + (theta - 1) * h * m0[i] + theta * h * m1[i]);
  }
}

class Solve {
 public:
  Solve(System& system, const SecondOrderProblem& problem)
      : p_(problem),
        grid_(problem.t0, problem.t1, problem.step),
        stepper_(system, problem.method, problem.x0, problem.v0, problem.threads),
        n_(stepper_.size()),
        longest_run_(system.polls() ? std::numeric_limits<std::int64_t>::max() : 1 << 16) {}

  SecondOrderSolution operator()() {
    solution_.time = p_.t0;
    before_ = stepper_.state;
    try {
      stepper_.start(p_.t0);
      output(0);
      advance();
    } catch (const NonFiniteError& error) {
      stepper_.state = before_;
      solution_.status = SecondOrderSolution::kNonFinite;
      solution_.failure = error.what();
      solution_.failure_time = error.time;
      solution_.failure_component = error.index;
    }
    const bool failed = solution_.status != SecondOrderSolution::kDone;
    if (failed && (solution_.t.empty() || solution_.t.back() != solution_.time)) {
      record(solution_.time);
    }
    solution_.evaluations = stepper_.evaluations;
    return std::move(solution_);
  }

 private:
  void advance() {
    if (grid_.too_fine()) {
      solution_.status = SecondOrderSolution::kStepUnderflow;
      return;
    }
    bool fused = !p_.every_step && !p_.callback;
    for (std::int64_t k = 0; k < grid_.steps();) {
      if (k >= p_.max_steps) {
        solution_.status = SecondOrderSolution::kTooManySteps;
        return;
      }
      before_ = stepper_.state;
      const std::int64_t together =
          fused ? std::min({quiet_steps(k), p_.max_steps - k, longest_run_}) : 0;
      if (together > 0) {
        fused = run(k, together);
        if (!fused) continue;
        k += together;
      } else {
        stepper_.step(grid_.time(k), grid_.h(k));
        if (!stepper_.finite()) throw overflow(k);
        ++k;
      }
      solution_.steps = k;
      solution_.time = grid_.time(k);
      output(k);
      if (p_.callback) p_.callback(solution_.time, stepper_.x(), stepper_.v());
      poll_interrupt();
    }
  }

  // Steps at once with the system's kernel. Where it has none, or where the end is not finite (the
  // single steps tell which one it was), false and the state of before.
  bool run(std::int64_t k, std::int64_t steps) {
    const std::int64_t evaluations = stepper_.evaluations;
    if (!stepper_.run(p_.t0, grid_.h(k), k, steps)) return false;
    if (stepper_.finite()) return true;
    stepper_.state = before_;
    stepper_.evaluations = evaluations;
    return false;
  }

  NonFiniteError overflow(std::int64_t k) const {
    const double* y = stepper_.state.y.data();
    const auto at = std::find_if(y, y + 2 * n_, [](double yi) { return !std::isfinite(yi); }) - y;
    return NonFiniteError(at < n_ ? "the position became infinite" : "the velocity became infinite",
                          grid_.time(k + 1), at % n_);
  }

  // How many whole steps from step k on no output falls into (one may be at their end).
  std::int64_t quiet_steps(std::int64_t k) const {
    if (next_ == p_.t_eval.size()) return grid_.full_steps() - k;
    return std::min(grid_.index_before(p_.t_eval[next_]), grid_.full_steps()) - k;
  }

  // The rows due up to the end of step k - 1, which began at before_.
  void output(std::int64_t k) {
    const double t = grid_.time(k);
    if (p_.every_step) return record(t);
    for (; next_ < p_.t_eval.size() && !grid_.before(t, p_.t_eval[next_]); ++next_) {
      const double wanted = p_.t_eval[next_];
      record(wanted);
      if (wanted == t) continue;
      const double h = grid_.h(k - 1), theta = (wanted - grid_.time(k - 1)) / h;
      const double *x = before_.y.data(), *v = x + n_, *a = before_.a.data();
      const auto row = static_cast<std::int64_t>(solution_.t.size()) - 1;
      hermite(n_, theta, h, x, v, stepper_.x(), stepper_.v(), solution_.x.data() + row * n_);
      hermite(n_, theta, h, v, a, stepper_.v(), stepper_.a(), solution_.v.data() + row * n_);
    }
  }

  void record(double t) {
    solution_.t.push_back(t);
    solution_.x.insert(solution_.x.end(), stepper_.x(), stepper_.x() + n_);
    solution_.v.insert(solution_.v.end(), stepper_.v(), stepper_.v() + n_);
  }

  const SecondOrderProblem& p_;
  const StepGrid grid_;
  SymplecticStepper stepper_;
  SymplecticStepper::State before_;
  const std::int64_t n_;
  const std::int64_t longest_run_;  // that is over before somebody waits for Ctrl-C
  std::size_t next_ = 0;            // in t_eval
  SecondOrderSolution solution_;
};

}  // namespace

SecondOrderSolution solve_second_order(System& system, const SecondOrderProblem& problem) {
  return Solve(system, problem)();
}

}  // namespace substep::ode
