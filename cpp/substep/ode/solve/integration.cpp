#include "substep/ode/solve/integration.h"

#include <algorithm>
#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/core/usize.h"

namespace substep::ode {
namespace {

// Finds how many steps take about ten milliseconds, so that polling for Ctrl-C costs nothing.
class Pace {
 public:
  std::int64_t steps() const { return steps_; }
  void taken(std::int64_t steps) {
    if ((left_ -= steps) > 0) return;
    poll_interrupt();
    const auto now = Clock::now();
    const auto elapsed = now - last_;
    if (elapsed < std::chrono::milliseconds(5)) steps_ *= 2;
    if (elapsed > std::chrono::milliseconds(20)) steps_ = std::max<std::int64_t>(1, steps_ / 2);
    left_ = steps_;
    last_ = now;
  }

 private:
  using Clock = std::chrono::steady_clock;
  std::int64_t steps_ = 1, left_ = 1;
  Clock::time_point last_ = Clock::now();
};

}  // namespace

// One thread at a time may drive an integration, and its own f may not.
class Integration::InUse {
 public:
  explicit InUse(std::atomic<std::thread::id>& user) : user_(user) {
    std::thread::id nobody{};
    const std::thread::id me = std::this_thread::get_id();
    if (user_.compare_exchange_strong(nobody, me)) return;
    throw InputError(nobody == me ? "this solver is running: its own function called it again"
                                  : "this solver is in use by another thread");
  }
  ~InUse() { user_ = std::thread::id{}; }
  InUse(const InUse&) = delete;
  InUse& operator=(const InUse&) = delete;

 private:
  std::atomic<std::thread::id>& user_;
};

void DenseSolution::evaluate(double t, double* out, std::int64_t stride) const {
  const bool rising = times.back() >= times.front();
  const auto at = rising ? std::lower_bound(times.begin(), times.end(), t)
                         : std::lower_bound(times.begin(), times.end(), t, std::greater<>());
  const std::int64_t step = std::clamp<std::int64_t>(at - times.begin() - 1, 0, steps() - 1);
  const auto s = usize(step), n = usize(size);
  const double theta = (t - times[s]) / lengths[s];
  const double* rows_of_step = F.data() + s * usize(rows) * n;
  for (std::int64_t i = 0; i < size; ++i) {
    out[i * stride] = ode::interpolate(rows, size, theta, starts.data() + s * n, rows_of_step, i);
  }
}

Integration::Integration(std::shared_ptr<System> system, std::string_view method,
                         const StepOptions& options, Output output)
    : system_(std::move(system)),
      stepper_(system_->make_stepper(method, options)),
      output_(std::move(output)),
      direction_(options.t_bound >= options.t ? 1.0 : -1.0) {
  if (output_.every_step) push(options.t, options.y);
  const auto& t_eval = output_.t_eval;
  while (next_eval_ < t_eval.size() && t_eval[next_eval_] == options.t) {
    push(t_eval[next_eval_++], options.y);
  }
  dense_.size = system_->size();
  dense_.rows = stepper_->dense_rows();
  if (output_.dense) dense_.times.push_back(options.t);
}

void Integration::start() {
  const InUse in_use(user_);
  stepper_->start();
}

std::int64_t Integration::run(std::int64_t steps) {
  const InUse in_use(user_);
  const bool may_leap = stepper_->fixed() && !output_.dense && !output_.interpolate;
  const std::int64_t first = stepper_->steps(), last = first + steps;
  Pace pace;
  while (stepper_->steps() < last && !stepper_->finished()) {
    const std::int64_t before = stepper_->steps();
    const std::int64_t most = system_->polls() ? last - before : pace.steps();
    if (!may_leap || !leap(std::min(last - before, most))) {
      stepper_->step();
      record();
    }
    pace.taken(stepper_->steps() - before);
  }
  return stepper_->steps() - first;
}

// Fixed steps at once, up to the next time of interest; false where that lies inside the next step.
bool Integration::leap(std::int64_t steps) {
  if (output_.every_step) {
    stepper_->advance(1);
    push(stepper_->t(), stepper_->y());
    return true;
  }
  const std::int64_t now = stepper_->steps();
  const bool waiting = next_eval_ < output_.t_eval.size();
  const double target = waiting ? output_.t_eval[next_eval_] : stepper_->t_bound();
  const std::int64_t index = stepper_->fixed_index(target);
  if (index <= now) return false;
  stepper_->advance(std::min(steps, index - now));
  const double slack = 4e-16 * std::max(std::fabs(target), std::fabs(stepper_->t()));
  if (waiting && std::fabs(stepper_->t() - target) <= slack) {
    push(target, stepper_->y());
    ++next_eval_;
  }
  return true;
}

void Integration::record() {
  const double t = stepper_->t();
  const auto& t_eval = output_.t_eval;
  const auto reached = [&](double at) { return direction_ * (at - t) <= 0.0; };
  const bool inside = next_eval_ < t_eval.size() && direction_ * (t_eval[next_eval_] - t) < 0.0;
  if (inside || output_.dense) polynomial();  // may fail, so before anything is kept
  if (output_.every_step) push(t, stepper_->y());
  while (next_eval_ < t_eval.size() && reached(t_eval[next_eval_])) {
    const double at = t_eval[next_eval_++];
    push(at, stepper_->y());
    if (at != t) polynomial_at(at, states_.data() + states_.size() - stepper_->size(), 1);
  }
  if (output_.dense) {
    const double* y_old = stepper_->y_old();
    dense_.F.insert(dense_.F.end(), F_.begin(), F_.end());
    dense_.starts.insert(dense_.starts.end(), y_old, y_old + stepper_->size());
    dense_.times.push_back(t);
    dense_.lengths.push_back(t - stepper_->t_old());
  }
}

void Integration::interpolate(double t, double* out, std::int64_t stride) {
  const InUse in_use(user_);
  if (stepper_->steps() == 0) throw InputError("no step has been made yet");
  polynomial_at(t, out, stride);
}

DenseSolution Integration::step_dense() {
  const InUse in_use(user_);
  if (stepper_->steps() == 0) throw InputError("no step has been made yet");
  polynomial();
  const double t_old = stepper_->t_old(), t = stepper_->t();
  const double* y_old = stepper_->y_old();
  return {stepper_->size(),
          dense_.rows,
          {t_old, t},
          {t - t_old},
          std::vector<double>(y_old, y_old + stepper_->size()),
          F_};
}

void Integration::polynomial_at(double t, double* out, std::int64_t stride) {
  const std::int64_t n = stepper_->size();
  const double* F = polynomial();
  const double theta = (t - stepper_->t_old()) / (stepper_->t() - stepper_->t_old());
  for (std::int64_t i = 0; i < n; ++i) {
    out[i * stride] = ode::interpolate(dense_.rows, n, theta, stepper_->y_old(), F, i);
  }
}

const double* Integration::polynomial() {
  if (polynomial_step_ != stepper_->steps()) {
    F_.resize(usize(dense_.rows) * usize(stepper_->size()));
    stepper_->dense(F_.data());
    polynomial_step_ = stepper_->steps();
  }
  return F_.data();
}

void Integration::push(double t, const double* y) {
  times_.push_back(t);
  states_.insert(states_.end(), y, y + stepper_->size());
}

void Integration::truncate(double t) {
  const InUse in_use(user_);
  while (!times_.empty() && direction_ * (times_.back() - t) > 0.0) times_.pop_back();
  states_.resize(times_.size() * usize(stepper_->size()));
  if (output_.dense && !dense_.times.empty()) dense_.times.back() = t;
}

}  // namespace substep::ode
