#include "substep/ode/systems/systems.h"

namespace substep::ode {

Pleiades::Pleiades(const double* masses) {
  for (int i = 0; i < 11; ++i) mass_[i] = masses[i % 7];
}

void Pleiades::accelerate(double, const double* x, const double*, double* a) const {
  // Bodies i and i + s, s = 1, 2, 3 round the circle of seven, are all 21 pairs once; the lane
  // i = 7 is body 0 again and dropped.
  constexpr int kBodies = 7, kLanes = 8, kShifts = 3;
  double px[kLanes + kShifts], py[kLanes + kShifts];
  for (int i = 0; i < kLanes + kShifts; ++i) {
    px[i] = x[i % kBodies];
    py[i] = x[kBodies + i % kBodies];
  }
  double ax[kLanes] = {}, ay[kLanes] = {};
  double bx[kShifts][kLanes + kBodies], by[kShifts][kLanes + kBodies];  // on i + s, periodic
  for (int s = 1; s <= kShifts; ++s) {
    for (int i = 0; i < kLanes; ++i) {
      const double dx = px[i + s] - px[i], dy = py[i + s] - py[i];
      const double weight = inverse_cube(dx, dy);
      const double wx = weight * dx, wy = weight * dy;
      ax[i] += mass_[i + s] * wx;
      ay[i] += mass_[i + s] * wy;
      bx[s - 1][i] = mass_[i] * wx;
      by[s - 1][i] = mass_[i] * wy;
    }
    for (int i = 0; i < kLanes; ++i) {
      bx[s - 1][i + kBodies] = bx[s - 1][i];
      by[s - 1][i + kBodies] = by[s - 1][i];
    }
  }
  for (int s = 1; s <= kShifts; ++s) {
    for (int i = 0; i < kLanes; ++i) {
      ax[i] -= bx[s - 1][i + kBodies - s];
      ay[i] -= by[s - 1][i + kBodies - s];
    }
  }
  for (int i = 0; i < kBodies; ++i) {
    a[i] = ax[i];
    a[kBodies + i] = ay[i];
  }
}

template class StaticSystem<Pleiades, 28>;

}  // namespace substep::ode
