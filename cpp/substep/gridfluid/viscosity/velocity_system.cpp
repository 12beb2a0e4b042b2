#include "substep/gridfluid/viscosity/velocity_system.h"

#include <algorithm>
#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/core/usize.h"
#include "substep/linalg/vectors.h"

namespace substep::gridfluid {
namespace {

constexpr std::int64_t kRowsOfTask = 1024;
constexpr int kSweeps = 2;  // before and after the blocks

}  // namespace

// z = (r - others) / diagonal, row by row.
template <int D>
void VelocitySystem<D>::sweep(bool forwards, int threads) {
  for_colours(rows.colours, forwards, kRowsOfTask, threads,
              [&](std::int64_t begin, std::int64_t end) {
                for (std::int64_t i = begin; i < end; ++i)
                  z_[usize(i)] = (r_[usize(i)] - rows.others(i, z_)) / rows.diagonal[usize(i)];
              });
}

template <int D>
void VelocitySystem<D>::precondition(int threads) {
  std::fill(z_.begin(), z_.end(), 0.0);
  for (int k = 0; k < kSweeps; ++k) sweep(true, threads);
  for_each_index(r_.size(), threads, [&](std::size_t i) {
    q_[i] = r_[i] - rows.others(static_cast<std::int64_t>(i), z_) - rows.diagonal[i] * z_[i];
  });
  blocks_.correct(rows, q_, z_, threads);
  for (int k = 0; k < kSweeps; ++k) sweep(false, threads);
}

template <int D>
ViscosityReport VelocitySystem<D>::solve(std::span<const double> b, std::span<double> x,
                                         double goal, int max_iterations, int threads) {
  ViscosityReport report;
  const std::size_t n = b.size();
  blocks_.find(rows, threads);
  r_.assign(b.begin(), b.end());
  for (auto* v : {&z_, &d_, &q_}) v->assign(n, 0.0);
  std::fill(x.begin(), x.end(), 0.0);
  double before = 0;
  for (;;) {
    poll_interrupt();
    precondition(threads);
    const double rz = dot(r_, z_, threads);
    report.finite = std::isfinite(rz);
    if (rz <= goal) return report;
    if (!report.finite) break;
    if (report.iterations == max_iterations) break;
    ++report.iterations;
    const double beta = before > 0 ? rz / before : 0;
    before = rz;
    for_each_index(n, threads, [&](std::size_t i) { d_[i] = z_[i] + beta * d_[i]; });
    for_each_index(n, threads, [&](std::size_t i) {
      q_[i] = rows.others(static_cast<std::int64_t>(i), d_) + rows.diagonal[i] * d_[i];
    });
    for (const BodyOfRows<D>& body : bodies) body.subtract(body.c * body.product(d_), q_);
    const double alpha = rz / dot(d_, q_, threads);
    for_each_index(n, threads, [&](std::size_t i) {
      x[i] += alpha * d_[i];
      r_[i] -= alpha * q_[i];
    });
  }
  report.converged = false;
  return report;
}

template class VelocitySystem<2>;
template class VelocitySystem<3>;

}  // namespace substep::gridfluid
