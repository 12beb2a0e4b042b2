// What rules a coordinate of a joint during a sub-step: limits, and a motor or a spring.
//
// The impulse l that acts along a coordinate is a decreasing function of its rate u, with vertical
// and horizontal pieces, the modes: where u would pass a limit, what holds it there; between them
// the motor's, that is within +- most what keeps the line u + compliance l = rate:
//   speed   rate is the target, compliance 0;
//   spring  l = -h (k (y - y0) + c u_0) - D (u - u_0), D = h^2 k / 4 + h c / 2, where y and u_0 are
//           the coordinate and its rate before: Newmark's method, beta 1/4, gamma 1/2 (Newmark
//           1959, J. Eng. Mech. 85), in the form of leapfrog: no step is too long for it, and
//           without c it keeps the energy. compliance is 1 / D.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

#include "substep/rigid/solver/joint.h"

namespace substep::rigid {

struct JointLaw {
  enum class Mode : std::uint8_t { kFree, kLower, kUpper, kLine, kMost, kLeast };
  enum class Stage : std::uint8_t { kMotion, kVelocity };  // of mean rates, or of those at its end

  // A sub-step. weight: of forces in it, half of one where a step begins and ends; smooth: no
  // contact presses; closes: the motion leads to C = 0, not to what C was.
  struct Interval {
    double h, weight;
    bool smooth, closes;
  };
  // With the coordinate y and its rate before, and the mass that an impulse along it finds.
  static JointLaw make(const Joint::Motor& motor, double lower, double upper,
                       const Interval& interval, Stage stage, Mode mode, double y, double before,
                       double mass);

  static constexpr double kInfinite = std::numeric_limits<double>::infinity();
  double slowest = -kInfinite, fastest = kInfinite;  // rates that lead to the limits
  bool driven = false;
  double rate = 0, compliance = 0, most = 0;  // most: an impulse
  double before = 0;                          // rate before the sub-step, of a spring

  static bool fixes_impulse(Mode mode) {
    return mode == Mode::kFree || mode == Mode::kMost || mode == Mode::kLeast;
  }
  double fixed_impulse(Mode mode) const {
    return mode == Mode::kMost ? most : mode == Mode::kLeast ? -most : 0;
  }
  // What must vanish in the other modes; l's coefficient there is softness().
  double residual(Mode mode, double u, double l) const {
    if (mode == Mode::kLine) return u - rate + compliance * l;
    return u - (mode == Mode::kLower ? slowest : fastest);
  }
  double softness(Mode mode) const { return mode == Mode::kLine ? compliance : 0; }

  // The mode of the piece nearest to (u, l), 1 / K the change of l for one of u: a step of the
  // semismooth Newton method (Hintermueller, Ito and Kunisch 2002, SIAM J. Optim. 13).
  Mode mode(double u, double l, double K) const {
    if (slowest == fastest || l - (u - slowest) / K > motor(slowest, 1)) return Mode::kLower;
    if (l - (u - fastest) / K < motor(fastest, -1)) return Mode::kUpper;
    if (!driven) return Mode::kFree;
    const double on_line = l - (u - rate + compliance * l) / (K + compliance);
    return on_line > most ? Mode::kMost : on_line < -most ? Mode::kLeast : Mode::kLine;
  }
  // The same, or that of now where a rate that differs by little leads to it; one: the next piece
  // in that direction, else a law alone may go back and forth between its ends.
  Mode next(Mode now, double u, double l, double K, double little, bool one) const {
    const Mode next = mode(u, l, K);
    if (mode(u - little, l, K) == now || mode(u + little, l, K) == now) return now;
    if (!one) return next;
    const int to = place(next);
    for (int k = place(now); k != to;)
      if (has(k += k < to ? 1 : -1)) return at(k);
    return next;
  }

 private:
  // Of the pieces, from the lower limit to the upper one.
  static int place(Mode mode) {
    constexpr int kPlaces[] = {2, 0, 4, 2, 1, 3};
    return kPlaces[static_cast<int>(mode)];
  }
  Mode at(int place) const {
    constexpr Mode kModes[] = {Mode::kLower, Mode::kMost, Mode::kLine, Mode::kLeast, Mode::kUpper};
    return place == 2 && !driven ? Mode::kFree : kModes[place];
  }
  // Whether there is such a piece between the limits.
  bool has(int place) const {
    if (!driven) return place == 2;
    const double half = compliance > 0 ? compliance * most : 0;  // of the line
    if (place == 1) return slowest < rate - half;
    if (place == 3) return rate + half < fastest;
    return slowest <= rate + half && rate - half <= fastest;
  }
  // Of the motor at the rate u; side: which, where it is of both.
  double motor(double u, double side) const {
    if (!driven) return 0;
    if (compliance > 0) return std::clamp((rate - u) / compliance, -most, most);
    return u == rate ? side * most : u < rate ? most : -most;
  }
};

// Which modes change: all that are others at once as long as that makes them fewer, else the first
// alone, which ends (Judice and Pires 1994, Comput. Oper. Res. 21; Murty 1974, Linear Algebra Appl.
// 9).
struct JointPivots {
  int count = 0;

  bool one() const { return tries_ >= kTries; }
  void add(int others) {
    ++count;
    tries_ = others < fewest_ ? 0 : tries_ + 1;
    fewest_ = std::min(fewest_, others);
  }

 private:
  static constexpr int kTries = 5;
  int tries_ = 0, fewest_ = std::numeric_limits<int>::max();
};

}  // namespace substep::rigid
