// The times of fixed steps: t_start + k h, the last step cut to end at t_bound.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "substep/core/errors.h"
#include "substep/ode/stepping/step_control.h"

namespace substep::ode {

class FixedGrid {
 public:
  FixedGrid() = default;
  FixedGrid(double t_start, double t_bound, double step)
      : t_start_(t_start), t_bound_(t_bound), h_(t_bound >= t_start ? step : -step) {
    const double span = (t_bound - t_start) / h_;
    if (!(span < 9e15) || t_start + h_ == t_start || t_bound - h_ == t_bound) {
      throw InputError("step: expected a step above the spacing of t, got " + format(step));
    }
    // A remainder within rounding of nothing is no step of its own.
    const double slack = std::max(1e-9, 4.0 * span * std::numeric_limits<double>::epsilon());
    steps_ = std::max<std::int64_t>(1, static_cast<std::int64_t>(std::ceil(span - slack)));
    whole_steps_ = std::fabs(span - static_cast<double>(steps_)) <= slack ? steps_ : steps_ - 1;
  }

  double t_start() const { return t_start_; }
  double h() const { return h_; }
  std::int64_t whole_steps() const { return whole_steps_; }

  // Number of whole steps from the start to t.
  std::int64_t index(double t) const {
    return t == t_bound_ ? steps_
                         : static_cast<std::int64_t>(std::floor((t - t_start_) / h_ + 1e-9));
  }
  double time(std::int64_t index) const {
    return index >= steps_ ? t_bound_ : t_start_ + static_cast<double>(index) * h_;
  }
  // Length of the step that begins at time(index) = t.
  double length(std::int64_t index, double t) const {
    return index < whole_steps_ ? h_ : time(index + 1) - t;
  }

 private:
  double t_start_ = 0.0, t_bound_ = 0.0, h_ = 0.0;
  std::int64_t steps_ = 0, whole_steps_ = 0;  // all, and those of full length
};

}  // namespace substep::ode
