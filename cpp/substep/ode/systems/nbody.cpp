#include "substep/ode/systems/nbody.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/parallel.h"

namespace substep::ode {
namespace {

constexpr int kLanes = 8;  // bodies whose sums run side by side, each over j in rising order

template <int dimension>
void accelerate(std::int64_t first, std::int64_t n, const double* gm, double softening2,
                const double* x, double* a) {
  const int count = static_cast<int>(std::min<std::int64_t>(kLanes, n - first));
  double xi[dimension][kLanes], sum[dimension][kLanes] = {}, index[kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {
    const std::int64_t i = first + std::min(lane, count - 1);
    index[lane] = static_cast<double>(i);
    for (int axis = 0; axis < dimension; ++axis) xi[axis][lane] = x[i * dimension + axis];
  }
  for (std::int64_t j = 0; j < n; ++j) {
    const double *xj = x + j * dimension, self = static_cast<double>(j);
    for (int lane = 0; lane < kLanes; ++lane) {
      double difference[dimension];
      // A body's own term is 0 times a finite number.
      double r2 = softening2 + (index[lane] == self ? 1.0 : 0.0);
      for (int axis = 0; axis < dimension; ++axis) {
        difference[axis] = xj[axis] - xi[axis][lane];
        r2 += difference[axis] * difference[axis];
      }
      const double weight = gm[j] / (r2 * std::sqrt(r2));
      for (int axis = 0; axis < dimension; ++axis) sum[axis][lane] += weight * difference[axis];
    }
  }
  for (int lane = 0; lane < count; ++lane) {
    for (int axis = 0; axis < dimension; ++axis) {
      a[(first + lane) * dimension + axis] = sum[axis][lane];
    }
  }
}

}  // namespace

NBody::NBody(std::vector<double> masses, double G, double softening, int dimension)
    : gm_(std::move(masses)), softening2_(softening * softening), dimension_(dimension) {
  if (dimension != 2 && dimension != 3) throw InputError("dimension: expected 2 or 3");
  for (double& mass : gm_) mass *= G;
}

void NBody::rhs(double t, const double* y, double* dydt) {
  const std::int64_t half = size() / 2;
  std::copy_n(y + half, half, dydt);
  acceleration(t, y, y + half, dydt + half);
}

void NBody::acceleration(double, const double* x, const double*, double* a) {
  const std::int64_t n = bodies();
  const auto rows = [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; i += kLanes) {
      if (dimension_ == 2) {
        accelerate<2>(i, n, gm_.data(), softening2_, x, a);
      } else {
        accelerate<3>(i, n, gm_.data(), softening2_, x, a);
      }
    }
  };
  // Chunks of about 1e5 pairs: whole blocks of lanes, so who shares a block never changes.
  const std::int64_t grain =
      kLanes * std::max<std::int64_t>(1, 12500 / std::max<std::int64_t>(n, 1));
  if (n <= grain) return rows(0, n);
  parallel_for(n, grain, rows);
}

}  // namespace substep::ode
