// What can be seen of a flow: sums, and numbers at points and in the middle of cells.
#include <algorithm>
#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/flow/between.h"
#include "substep/gridfluid/flow/flow.h"

namespace substep::gridfluid {

template <class Real, int D>
std::vector<Cell> Flow<Real, D>::cells() {
  obstacles_.colliders = colliders;
  find_domain();
  return {projection_.cells().begin(), projection_.cells().end()};
}

template <class Real, int D>
FlowSums Flow<Real, D>::sums() {
  obstacles_.colliders = colliders;
  find_domain();
  const std::span<const Cell> cells = projection_.cells();
  const bool cut = obstacles_.any(), moving = obstacles_.moving();
  struct Part {
    double kinetic = 0, fluid = 0, divergence = 0, speed = 0;
    std::array<double, D> momentum{};
    std::vector<double> scalars;
  };
  Part none;
  none.scalars.resize(scalars_.size());
  // Half of what each face has is the cell's.
  const auto of_row = [&](std::int64_t begin, std::int64_t end) {
    Part part = none;
    for (std::int64_t i = begin; i < end; ++i) {
      if (cells[usize(i)] != Cell::kFluid) continue;
      double divergence = 0;
      const double rho =
          two_fluids() ? double(density_of(scalars_[usize(options.smoke)][usize(i)])) : 1;
      for (std::size_t a = 0; a < D; ++a) {
        double largest = 0;
        for (std::size_t end_of = 0; end_of < 2; ++end_of) {
          const std::size_t f = usize(end_of == 0 ? i : i + layout_.stride[a]);
          const double v = double(velocity_[a][f]);
          const int axis = static_cast<int>(a);
          const double open = cut ? double(obstacles_.open(axis)[f]) : 1;
          const double theirs = moving ? double(obstacles_.displacing(axis)[f]) : 0;
          part.kinetic += rho * open * v * v / 4;
          part.momentum[a] += rho * open * v / 2;
          divergence += (end_of == 0 ? -1 : 1) * (open * v + (1 - open) * theirs);
          largest = std::max(largest, std::abs(v));
        }
        part.speed = std::max(part.speed, largest);
      }
      part.divergence = std::max(part.divergence, std::abs(divergence));
      for (std::size_t k = 0; k < scalars_.size(); ++k) {
        part.scalars[k] += double(scalars_[k][usize(i)]);
      }
      part.fluid += 1;
    }
    return part;
  };
  const Part all = gather_rows(layout_, all_cells(layout_), options.threads, none, of_row,
                               [](Part& total, const Part& part) {
                                 total.kinetic += part.kinetic;
                                 total.fluid += part.fluid;
                                 total.divergence = std::max(total.divergence, part.divergence);
                                 total.speed = std::max(total.speed, part.speed);
                                 for (std::size_t a = 0; a < D; ++a) {
                                   total.momentum[a] += part.momentum[a];
                                 }
                                 for (std::size_t k = 0; k < part.scalars.size(); ++k) {
                                   total.scalars[k] += part.scalars[k];
                                 }
                               });
  FlowSums sums{.kinetic = mass() * all.kinetic,
                .momentum = Vec3::Zero(),
                .divergence = all.divergence / dx_,
                .speed = all.speed,
                .scalars = all.scalars};
  for (std::size_t a = 0; a < D; ++a) sums.momentum[static_cast<int>(a)] = mass() * all.momentum[a];
  for (double& x : sums.scalars) x /= std::max(all.fluid, 1.0);
  return sums;
}

// The 1 of 1 + number is lost beside larger ones, and with it the mean.
template <class Real, int D>
double Flow<Real, D>::longest_step() const {
  constexpr double kMost = sizeof(Real) == 4 ? 4e3 : 1e12;
  double most = options.viscosity;
  for (const ScalarOptions& scalar : options.scalars) most = std::max(most, scalar.diffusivity);
  return kMost * dx_ * dx_ / most;
}

template <class Real, int D>
FlowLimits Flow<Real, D>::limits() const {
  const auto largest = [](double& total, double part) { total = std::max(total, part); };
  const auto most = [&](const auto& of_cell) {
    return gather_rows(
        layout_, all_cells(layout_), options.threads, 0.0,
        [&](std::int64_t begin, std::int64_t end) {
          Real part = 0;
          for (std::int64_t i = begin; i < end; ++i) part = std::max(part, of_cell(i));
          return double(part);
        },
        largest);
  };
  FlowLimits limits;
  limits.longest = longest_step();
  limits.courant = most([&](std::int64_t i) {
    Real sum = 0;
    for (std::size_t a = 0; a < D; ++a) {
      sum += std::max(std::abs(velocity_[a][usize(i)]),
                      std::abs(velocity_[a][usize(i + layout_.stride[a])]));
    }
    return sum;
  });
  for (std::size_t k = 0; k < scalars_.size(); ++k) {
    const Real ambient = Real(options.scalars[k].ambient);
    const double difference =
        most([&](std::int64_t i) { return std::abs(scalars_[k][usize(i)] - ambient); });
    limits.acceleration +=
        options.gravity.norm() * std::abs(options.scalars[k].buoyancy) * difference;
  }
  if (two_fluids()) {  // as a ball of the lighter one in the heavier
    const auto [light, heavy] = std::minmax(options.density, options.smoke_density);
    limits.acceleration += options.gravity.norm() * (heavy - light) / (light + heavy / 2);
  }
  return limits;
}

template <class Real, int D>
std::vector<double> Flow<Real, D>::sample(std::span<const Vec3> points) {
  start(0);
  std::vector<double> p(pressure_.begin(), pressure_.end());
  into_cells_.apply(layout_, std::span<double>(p));
  const Velocity<Real, D>& u = start_;
  const std::size_t columns = D + 1 + scalars_.size();
  std::vector<double> out(points.size() * columns);
  for (std::size_t n = 0; n < points.size(); ++n) {
    if (n % 4096 == 0) poll_interrupt();
    std::array<Real, D> x, within;
    for (std::size_t a = 0; a < D; ++a) {
      const int k = static_cast<int>(a);
      const double cells_in = (points[n][k] - low_[k]) / dx_;
      x[a] = Real(std::clamp(cells_in, 0.0, double(layout_.cells[a])));
      within[a] = std::clamp(x[a], Real(0.5), Real(layout_.cells[a]) - Real(0.5));
    }
    double* row = out.data() + n * columns;
    const std::array<Real, D> v = velocity_at<Real, D>(layout_, u, x);
    for (std::size_t a = 0; a < D; ++a) row[a] = double(v[a]);
    Between<double, D> in;
    const Between<Real, D> at = between<Real, D>(layout_, within, -1);
    in.base = at.base;
    for (std::size_t a = 0; a < D; ++a) in.part[a] = double(at.part[a]);
    row[D] = options.density * interpolate(layout_, p, in);
    for (std::size_t k = 0; k < scalars_.size(); ++k) {
      row[D + 1 + k] =
          double(interpolate(layout_, start_scalars_[k], between<Real, D>(layout_, x, -1)));
    }
  }
  return out;
}

template <class Real, int D>
std::vector<double> Flow<Real, D>::centred() const {
  std::vector<double> out;
  out.reserve(usize(layout_.count()) * D);
  for (std::int64_t r = 0; r < layout_.rows(); ++r) {
    const std::int64_t begin = layout_.row(r);
    for (std::int64_t i = begin; i < begin + layout_.row_length(); ++i) {
      for (std::size_t a = 0; a < D; ++a) {
        const std::size_t above = usize(i + layout_.stride[a]);
        out.push_back((double(velocity_[a][usize(i)]) + double(velocity_[a][above])) / 2);
      }
    }
  }
  return out;
}

template std::vector<Cell> Flow<float, 2>::cells();
template std::vector<Cell> Flow<float, 3>::cells();
template std::vector<Cell> Flow<double, 2>::cells();
template std::vector<Cell> Flow<double, 3>::cells();
template FlowSums Flow<float, 2>::sums();
template FlowSums Flow<float, 3>::sums();
template FlowSums Flow<double, 2>::sums();
template FlowSums Flow<double, 3>::sums();
template double Flow<float, 2>::longest_step() const;
template double Flow<float, 3>::longest_step() const;
template double Flow<double, 2>::longest_step() const;
template double Flow<double, 3>::longest_step() const;
template FlowLimits Flow<float, 2>::limits() const;
template FlowLimits Flow<float, 3>::limits() const;
template FlowLimits Flow<double, 2>::limits() const;
template FlowLimits Flow<double, 3>::limits() const;
template std::vector<double> Flow<float, 2>::sample(std::span<const Vec3>);
template std::vector<double> Flow<float, 3>::sample(std::span<const Vec3>);
template std::vector<double> Flow<double, 2>::sample(std::span<const Vec3>);
template std::vector<double> Flow<double, 3>::sample(std::span<const Vec3>);
template std::vector<double> Flow<float, 2>::centred() const;
template std::vector<double> Flow<float, 3>::centred() const;
template std::vector<double> Flow<double, 2>::centred() const;
template std::vector<double> Flow<double, 3>::centred() const;

}  // namespace substep::gridfluid
