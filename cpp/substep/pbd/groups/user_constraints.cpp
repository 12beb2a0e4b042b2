#include "substep/pbd/groups/user_constraints.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/usize.h"

namespace substep::pbd {

template <class Real>
UserGroup<Real>::UserGroup(UserConstraints constraints)
    : constraints_(std::move(constraints)),
      lambda_(constraints_.compliance.size(), 0.0),
      share_(constraints_.stiffness) {}

template <class Real>
void UserGroup<Real>::attach(const Partition& partition) {
  slot_.resize(constraints_.particles.size());
  for (std::size_t k = 0; k < slot_.size(); ++k) {
    slot_[k] = partition.slot[usize(constraints_.particles[k])];
  }
}

// Plain PBD: 1 - k of the error is left after all projections of a step.
template <class Real>
void UserGroup<Real>::begin_step(double /*h*/, int substeps, int iterations) {
  const double n = static_cast<double>(substeps) * iterations;
  for (std::size_t j = 0; j < share_.size(); ++j) {
    const double k = constraints_.stiffness[j];
    share_[j] = k < 1 ? -std::expm1(std::log1p(-k) / n) : 1;
  }
}

template <class Real>
void UserGroup<Real>::evaluate(std::int64_t first, std::int64_t count, const Sweep<Real>& sweep,
                               std::vector<double>& x, double* c, double* gradient) const {
  const auto points = usize(constraints_.points);
  const std::size_t begin = usize(first) * points;
  x.resize(usize(count) * points * 3);
  for (std::size_t k = 0; k < x.size() / 3; ++k) {
    const Point<Real>& p = sweep.x[slot_[begin + k]];
    x[3 * k] = constraints_.origin[0] + p.x;
    x[3 * k + 1] = constraints_.origin[1] + p.y;
    x[3 * k + 2] = constraints_.origin[2] + p.z;
  }
  constraints_.function->evaluate(first, count, x.data(), c, gradient);
  for (std::size_t j = 0; j < usize(count); ++j) {
    bool finite = std::isfinite(c[j]);
    for (std::size_t k = 0; k < 3 * points; ++k) {
      finite &= std::isfinite(gradient[3 * points * j + k]);
    }
    if (!finite) {
      const std::int64_t index = first + static_cast<std::int64_t>(j);
      throw NonFiniteError("the value or the gradient of custom constraint " +
                               std::to_string(index) + " is not finite",
                           std::nan(""), index);
    }
  }
}

template <class Real>
bool UserGroup<Real>::project_one(std::size_t j, const Sweep<Real>& sweep, const double* x,
                                  double c, const double* gradient) {
  const auto points = usize(constraints_.points);
  double squares = 0, weight = 0, rate = 0;
  for (std::size_t i = 0; i < points; ++i) {
    const std::int32_t s = slot_[j * points + i];
    const Point<Real>&now = sweep.x[s], &old = sweep.x_old[s];
    const double* g = gradient + 3 * i;
    const double square = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
    squares += square;
    weight += now.w * square;
    c += g[0] * (constraints_.origin[0] + now.x - x[3 * i]) +
         g[1] * (constraints_.origin[1] + now.y - x[3 * i + 1]) +
         g[2] * (constraints_.origin[2] + now.z - x[3 * i + 2]);
    rate += g[0] * (double(now.x) - old.x) + g[1] * (double(now.y) - old.y) +
            g[2] * (double(now.z) - old.z);
  }
  if (constraints_.inequality && c >= 0) return false;
  if (!(squares > 0)) return c != 0;
  const double alpha = constraints_.compliance[j] / (sweep.h * sweep.h);
  const double gamma = constraints_.compliance[j] * constraints_.damping[j] / sweep.h;
  const double below = (1 + gamma) * weight + alpha;
  if (!(below > 0) || !std::isfinite(below)) return !std::isfinite(below);
  double change = share_[j] * -(c + alpha * lambda_[j] + gamma * rate) / below;
  if (constraints_.inequality) change = std::max(change, -lambda_[j]);  // it never pulls
  lambda_[j] += change;
  for (std::size_t i = 0; i < points; ++i) {
    Point<Real>& p = sweep.x[slot_[j * points + i]];
    const double scale = p.w * change;
    p.x = static_cast<Real>(p.x + scale * gradient[3 * i]);
    p.y = static_cast<Real>(p.y + scale * gradient[3 * i + 1]);
    p.z = static_cast<Real>(p.z + scale * gradient[3 * i + 2]);
  }
  return false;
}

template <class Real>
std::int64_t UserGroup<Real>::project(int /*phase*/, std::int64_t /*chunk*/,
                                      const Sweep<Real>& sweep) {
  if (sweep.iteration == 0) std::fill(lambda_.begin(), lambda_.end(), 0.0);
  const auto width = 3 * usize(constraints_.points);
  const std::int64_t batch = std::min(constraints_.batch, size());
  std::vector<double> x, c(usize(batch)), gradient(c.size() * width);
  std::int64_t skipped = 0;
  for (std::int64_t first = 0; first < size(); first += batch) {
    if (first % 4096 == 0) poll_interrupt();
    const std::int64_t count = std::min(batch, size() - first);
    evaluate(first, count, sweep, x, c.data(), gradient.data());
    for (std::size_t k = 0; k < usize(count); ++k) {
      skipped += project_one(usize(first) + k, sweep, x.data() + width * k, c[k],
                             gradient.data() + width * k);
    }
  }
  return skipped;
}

template <class Real>
void UserGroup<Real>::values(const Sweep<Real>& sweep, std::span<double> c) const {
  std::vector<double> x, gradient(usize(constraints_.batch) * 3 * usize(constraints_.points));
  for (std::int64_t first = 0; first < size(); first += constraints_.batch) {
    const std::int64_t count = std::min(constraints_.batch, size() - first);
    evaluate(first, count, sweep, x, c.data() + first, gradient.data());
  }
}

template <class Real>
void UserGroup<Real>::multipliers(std::span<double> lambda) const {
  std::copy(lambda_.begin(), lambda_.end(), lambda.begin());
}

template <class Real>
double UserGroup<Real>::energy(const Sweep<Real>& sweep) const {
  const auto soft = [](double alpha) { return alpha > 0; };
  if (std::none_of(constraints_.compliance.begin(), constraints_.compliance.end(), soft)) return 0;
  std::vector<double> c(lambda_.size());
  values(sweep, c);
  double sum = 0;
  for (std::size_t j = 0; j < c.size(); ++j) {
    if (!soft(constraints_.compliance[j]) || (constraints_.inequality && c[j] >= 0)) continue;
    sum += c[j] * c[j] / (2 * constraints_.compliance[j]);
  }
  return sum;
}

template class UserGroup<float>;
template class UserGroup<double>;

}  // namespace substep::pbd
