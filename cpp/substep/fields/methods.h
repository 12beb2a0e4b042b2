// Explicit Runge-Kutta methods with fixed step, as tables: k_i = f(t + c_i h, x + h sum_j a_ij
// k_j), x(t + h) = x + h/D sum_i b_i k_i
// with whole b_i and their sum D. Hairer, Norsett, Wanner, "Solving Ordinary Differential
// Equations I", section II.1. The loops unroll and zeros vanish, so a stage costs what it needs.
#pragma once

#include "substep/core/errors.h"
#include "substep/core/lanes.h"
#include "substep/fields/steps.h"

namespace substep::fields {

struct Euler {
  static constexpr const char* kName = "euler";
  static constexpr int kStages = 1;
  static constexpr double a[1][1] = {{0}};
  static constexpr double b[1] = {1}, divisor = 1;
  static constexpr double c[1] = {0};
};
struct Midpoint {  // Runge 1895; table 1.1
  static constexpr const char* kName = "midpoint";
  static constexpr int kStages = 2;
  static constexpr double a[2][2] = {{0, 0}, {0.5, 0}};
  static constexpr double b[2] = {0, 1}, divisor = 1;
  static constexpr double c[2] = {0, 0.5};
};
struct Heun {  // the explicit trapezoidal rule, of order 2
  static constexpr const char* kName = "heun";
  static constexpr int kStages = 2;
  static constexpr double a[2][2] = {{0, 0}, {1, 0}};
  static constexpr double b[2] = {1, 1}, divisor = 2;
  static constexpr double c[2] = {0, 1};
};
struct Rk4 {  // Kutta 1901; table 1.2, left
  static constexpr const char* kName = "rk4";
  static constexpr int kStages = 4;
  static constexpr double a[4][4] = {{0, 0, 0, 0}, {0.5, 0, 0, 0}, {0, 0.5, 0, 0}, {0, 0, 1, 0}};
  static constexpr double b[4] = {1, 2, 2, 1}, divisor = 6;
  static constexpr double c[4] = {0, 0.5, 0.5, 1};
};

// Calls action(method) for each method of the list.
template <class Action>
void for_each_method(Action&& action) {
  action(Euler{});
  action(Midpoint{});
  action(Heun{});
  action(Rk4{});
}

}  // namespace substep::fields
