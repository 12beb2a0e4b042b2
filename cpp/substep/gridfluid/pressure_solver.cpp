#include "substep/gridfluid/pressure_solver.h"

#include <cmath>

#include "substep/core/usize.h"
#include "substep/gridfluid/ghosts.h"

namespace substep::gridfluid {

template <class Real, int D>
void PressureSolver<Real, D>::set_matrix(std::array<std::span<const Real>, D> w,
                                         std::span<const Cell> cells, int) {
  w_ = w;
  cells_ = cells;
}

template <class Real, int D>
SolveReport PressureSolver<Real, D>::solve(std::span<const Real> b, std::span<double> x,
                                           double tolerance, int, int) {
  std::vector<std::int64_t> fluid;
  for (std::int64_t r = 0; r < layout_.rows(); ++r)
    for (std::int64_t i = layout_.row(r); i < layout_.row(r) + layout_.row_length(); ++i)
      if (cells_[usize(i)] == Cell::kFluid) fluid.push_back(i);
  const std::size_t n = usize(layout_.size);
  std::vector<double> r(n), p(n), q(n), z(n), d(n);
  bool air = false;
  for (auto i : fluid) {
    for (std::size_t a = 0; a < D; ++a) {
      const auto s = layout_.stride[a];
      d[usize(i)] += double(w_[a][usize(i)] + w_[a][usize(i + s)]);
      air |= cells_[usize(i - s)] == Cell::kAir || cells_[usize(i + s)] == Cell::kAir;
    }
  }
  const auto apply = [&](std::span<double> v, std::vector<double>& out) {
    wrap_ghosts(layout_, v);
    for (auto i : fluid) {
      double sum = d[usize(i)] * v[usize(i)];
      for (std::size_t a = 0; a < D; ++a) {
        const auto s = layout_.stride[a];
        if (cells_[usize(i - s)] == Cell::kFluid) sum -= double(w_[a][usize(i)]) * v[usize(i - s)];
        if (cells_[usize(i + s)] == Cell::kFluid)
          sum -= double(w_[a][usize(i + s)]) * v[usize(i + s)];
      }
      out[usize(i)] = sum;
    }
  };
  const auto dot = [&](const std::vector<double>& u, const std::vector<double>& v) {
    double sum = 0;
    for (auto i : fluid) sum += u[usize(i)] * v[usize(i)];
    return sum;
  };
  double mean = 0;
  if (!air)
    for (auto i : fluid) mean += double(b[usize(i)]) / double(fluid.size());
  for (std::size_t i = 0; i < n; ++i)
    if (cells_[i] != Cell::kFluid) x[i] = 0;
  apply(x, q);
  double bb = 0;
  for (auto i : fluid) {
    r[usize(i)] = double(b[usize(i)]) - mean - q[usize(i)];
    bb += std::pow(double(b[usize(i)]) - mean, 2);
  }
  SolveReport report;
  double rz = 0;
  const double goal = tolerance * std::sqrt(bb);
  for (report.iterations = 0; report.iterations < 20000; ++report.iterations) {
    if (std::sqrt(dot(r, r)) <= goal) break;
    for (auto i : fluid) z[usize(i)] = d[usize(i)] > 0 ? r[usize(i)] / d[usize(i)] : 0;
    const double next = dot(r, z);
    for (auto i : fluid) p[usize(i)] = z[usize(i)] + (rz > 0 ? next / rz : 0) * p[usize(i)];
    rz = next;
    apply(p, q);
    const double alpha = rz / dot(p, q);
    for (auto i : fluid) {
      x[usize(i)] += alpha * p[usize(i)];
      r[usize(i)] -= alpha * q[usize(i)];
    }
  }
  report.residual = bb > 0 ? std::sqrt(dot(r, r) / bb) : 0;
  report.converged = std::sqrt(dot(r, r)) <= goal;
  return report;
}

template class PressureSolver<float, 2>;
template class PressureSolver<float, 3>;
template class PressureSolver<double, 2>;
template class PressureSolver<double, 3>;

}  // namespace substep::gridfluid
