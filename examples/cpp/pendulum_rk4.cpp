// A pendulum by RK4, beside its period in closed form: theta'' = -(g / l) sin theta swings with
//
//   T = 4 sqrt(l / g) K(sin(theta_0 / 2)),   K: Legendre's complete elliptic integral.
//
// After T it is back where it began, and at rest. What it misses of that falls by nearly 16 when
// the step is halved, for RK4 is of order 4; what its energy loses on the way is of order 5.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <utility>

#include "substep/ode/solve/integration.h"

namespace {

constexpr double kGravity = 9.81, kLength = 1.0, kStart = 2.5;  // [m/s^2], [m], [rad]

class Pendulum final : public substep::ode::System {
 public:
  std::int64_t size() const override { return 2; }
  void rhs(double /*t*/, const double* y, double* dydt) override {
    dydt[0] = y[1];
    dydt[1] = -kGravity / kLength * std::sin(y[0]);
  }
};

double energy(double theta, double omega) {  // per mass [J/kg]
  return 0.5 * kLength * kLength * omega * omega - kGravity * kLength * std::cos(theta);
}

struct Missed {
  double state, energy;
};
Missed swing(double period, int steps) {
  const double start[] = {kStart, 0.0};
  substep::ode::StepOptions options;
  options.y = start;
  options.t_bound = period;
  options.step = period / steps;
  substep::ode::Integration run(std::make_shared<Pendulum>(), "rk4", options, {});
  run.start();
  while (!run.stepper().finished()) run.run(steps);
  const double* y = run.stepper().y();
  return {std::hypot(y[0] - kStart, y[1] * std::sqrt(kLength / kGravity)),
          std::abs(energy(y[0], y[1]) - energy(kStart, 0.0))};
}

}  // namespace

int main() {
  const double period =
      4 * std::sqrt(kLength / kGravity) * std::comp_ellint_1(std::sin(kStart / 2));
  std::printf("period %.6f s\n steps   state missed [rad]   energy lost [J/kg]\n", period);
  Missed missed{}, before{};
  for (int steps = 100; steps <= 1600; steps *= 2) {
    before = std::exchange(missed, swing(period, steps));
    std::printf("%6d %20.3e %20.3e\n", steps, missed.state, missed.energy);
  }
  const double order = std::log2(before.state / missed.state);
  std::printf("order %.3f\n", order);
  return std::abs(order - 4) < 0.15 && missed.energy < 1e-9 ? 0 : 1;
}
