#include "substep/gridfluid/pressure/transform_solver.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <string>

#include "substep/gridfluid/pressure/packet.h"

namespace {

using namespace substep::gridfluid;
using substep::usize;

constexpr std::array kAllEnds{LineEnds::kWalls, LineEnds::kOpen, LineEnds::kWallOpen,
                              LineEnds::kOpenWall, LineEnds::kPeriodic};
using Numbers = std::vector<double>;

// Second differences, cell by cell.
Numbers differences(const Numbers& x, LineEnds ends) {
  const std::size_t n = x.size();
  const bool periodic = ends == LineEnds::kPeriodic;
  const bool open_low = ends == LineEnds::kOpen || ends == LineEnds::kOpenWall;
  const bool open_high = ends == LineEnds::kOpen || ends == LineEnds::kWallOpen;
  Numbers out(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double low = i > 0 ? x[i - 1] : periodic ? x[n - 1] : open_low ? -x[0] : x[0];
    const double high = i + 1 < n ? x[i + 1] : periodic ? x[0] : open_high ? -x[i] : x[i];
    out[i] = (x[i] - low) + (x[i] - high);
  }
  return out;
}

// Line number `lane` of z back from its coefficients.
Numbers back(const LineTransform& line, Numbers z, int lane) {
  line.backward(z.data());
  Numbers x;
  for (int i = 0; i < line.size(); ++i) {
    x.push_back(line.factor(i) * line.scale() * z[usize(line.place(i) * kLines + lane)]);
  }
  return x;
}

TEST(LineTransform, coefficients_are_of_eigenvectors_and_come_back) {
  std::mt19937 generator(3);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (const int n : {1, 2, 3, 4, 5, 6, 7, 8, 11, 13, 30, 33, 64, 91, 128, 360}) {
    for (const LineEnds ends : kAllEnds) {
      const LineTransform line(n, ends);
      SCOPED_TRACE("n " + std::to_string(n) + ", ends " + std::to_string(static_cast<int>(ends)));
      for (int k = 0; k < n; ++k) {
        const int lane = k % kLines;
        Numbers z(usize(n * kLines));
        z[usize(k * kLines + lane)] = std::sqrt(n);
        const Numbers x = back(line, z, lane), ax = differences(x, ends);
        double largest = 0;
        for (std::size_t i = 0; i < x.size(); ++i) {
          ASSERT_NEAR(ax[i], line.eigenvalue(k) * x[i], 1e-12) << k;
          largest = std::max(largest, std::abs(x[i]));
        }
        ASSERT_GT(largest, 0.4 / std::sqrt(n));
        for (const double other : back(line, z, (lane + 1) % kLines)) ASSERT_EQ(other, 0);
      }
      Numbers x, z(usize(n * kLines));
      for (double& value : z) x.push_back(value = uniform(generator));
      for (int i = 0; i < n; ++i) {
        for (int l = 0; l < kLines; ++l) {
          z[usize(line.place(i) * kLines + l)] = line.factor(i) * x[usize(i * kLines + l)];
        }
      }
      line.forward(z.data());
      for (int l = 0; l < kLines; ++l) {
        const Numbers found = back(line, z, l);
        for (int i = 0; i < n; ++i) ASSERT_NEAR(found[usize(i)], x[usize(i * kLines + l)], 1e-13);
      }
    }
  }
}

TEST(LineTransform, lengths_with_large_prime_factors_are_told) {
  for (const int n : {1, 2, 26, 77, 128, 169, 1000, 1001}) EXPECT_TRUE(LineTransform::can(n)) << n;
  for (const int n : {17, 34, 57, 127, 1018}) EXPECT_FALSE(LineTransform::can(n)) << n;
}

// A box of fluid with these sides, and a right-hand side by chance.
template <class Real, int D>
struct Box {
  Box(const std::array<int, D>& n, const std::array<LineEnds, D>& ends)
      : layout(n, periodic(ends)),
        cells(usize(layout.size), Cell::kSolid),
        b(usize(layout.size)),
        p(usize(layout.size)) {
    std::mt19937 generator(11);
    std::uniform_real_distribution<double> uniform(-0.5, 0.5);
    for (std::size_t a = 0; a < D; ++a) {
      const LineEnds of = ends[a];
      open[a] = {of == LineEnds::kOpen || of == LineEnds::kOpenWall,
                 of == LineEnds::kOpen || of == LineEnds::kWallOpen};
      closed = closed && !open[a][0] && !open[a][1];
      w[a].assign(usize(layout.size), 0);
      for (int side = 0; side < 2; ++side) {
        for_side(layout, int(a), side, [&](std::int64_t, std::int64_t ghost, std::int64_t) {
          if (layout.periodic[a]) cells[usize(ghost)] = Cell::kFluid;
          if (open[a][usize(side)]) cells[usize(ghost)] = Cell::kAir;
        });
      }
    }
    layout.for_cells([&](std::int64_t i) { cells[usize(i)] = Cell::kFluid; });
    layout.for_cells([&](std::int64_t i) {
      b[usize(i)] = static_cast<Real>(uniform(generator));
      for (std::size_t a = 0; a < D; ++a) {
        const std::int64_t s = layout.stride[a];
        const auto weight = [&](std::int64_t beyond) {
          const Cell there = cells[usize(beyond)];
          return static_cast<Real>(there == Cell::kFluid ? 1 : there == Cell::kAir ? 2 : 0);
        };
        w[a][usize(i)] = weight(i - s), w[a][usize(i + s)] = weight(i + s);
      }
    });
  }
  static std::array<bool, D> periodic(const std::array<LineEnds, D>& ends) {
    std::array<bool, D> found;
    for (std::size_t a = 0; a < D; ++a) found[a] = ends[a] == LineEnds::kPeriodic;
    return found;
  }
  std::array<std::span<const Real>, D> weights() const {
    std::array<std::span<const Real>, D> spans;
    for (std::size_t a = 0; a < D; ++a) spans[a] = w[a];
    return spans;
  }
  SolveReport solve(int threads = 1) {
    return TransformSolver<Real, D>(layout, open).solve(weights(), b, p, threads);
  }
  // |b - A p| / |b| of b without its mean where nothing is open.
  double residual() const {
    double sum = 0, rr = 0, bb = 0;
    layout.for_cells([&](std::int64_t i) { sum += double(b[usize(i)]); });
    const double mean = closed ? sum / double(layout.count()) : 0;
    layout.for_cells([&](std::int64_t i) {
      const double right = double(b[usize(i)]) - mean;
      double r = right;
      const std::array<int, D> cell = layout.cell(i);
      for (std::size_t a = 0; a < D; ++a) {
        for (const int step : {-1, 1}) {
          std::array<int, D> beside = cell;
          beside[a] += step;
          const bool inside = beside[a] >= 0 && beside[a] < layout.cells[a];
          beside[a] = (beside[a] + layout.cells[a]) % layout.cells[a];
          const double own = p[usize(i)], other = p[usize(layout.index(beside))];
          if (inside || layout.periodic[a]) {
            r -= own - other;
          } else if (open[a][step > 0]) {
            r -= 2 * own;
          }
        }
      }
      rr += r * r, bb += right * right;
    });
    return bb > 0 ? std::sqrt(rr / bb) : std::sqrt(rr);
  }

  Layout<D> layout;
  OpenSides<D> open;
  bool closed = true;
  std::vector<Cell> cells;
  std::array<std::vector<Real>, D> w;
  std::vector<Real> b;
  std::vector<double> p;
};

template <class T>
struct TransformSolverOf : testing::Test {};
template <class Real_, int kDimension>
struct OfKind {
  using Real = Real_;
  static constexpr int D = kDimension;
};
using AllKinds =
    testing::Types<OfKind<float, 2>, OfKind<float, 3>, OfKind<double, 2>, OfKind<double, 3>>;
TYPED_TEST_SUITE(TransformSolverOf, AllKinds);

TYPED_TEST(TransformSolverOf, solutions_are_exact_and_those_of_multigrid) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  constexpr std::array kSizes{1, 2, 3, 5, 6, 7, 30, 33, 16, 64};
  std::mt19937 generator(1);
  for (int trial = 0; trial < 150; ++trial) {
    std::array<int, D> n;
    std::array<LineEnds, D> ends;
    for (std::size_t a = 0; a < D; ++a) {
      n[a] = kSizes[generator() % kSizes.size()];
      ends[a] = kAllEnds[generator() % kAllEnds.size()];
      if (n[a] == 1 && ends[a] == LineEnds::kPeriodic) n[a] = 4;
    }
    Box<Real, D> box(n, ends);
    const SolveReport report = box.solve();
    std::string trace;
    for (std::size_t a = 0; a < D; ++a) {
      trace += std::to_string(n[a]) + " by " + std::to_string(static_cast<int>(ends[a])) + ' ';
    }
    SCOPED_TRACE(trace);
    EXPECT_TRUE(report.direct && report.converged);
    EXPECT_EQ(report.iterations, 1);
    EXPECT_EQ(report.closed_regions, box.closed);
    EXPECT_LT(box.residual(), 1e-12);
    EXPECT_NEAR(report.residual, box.residual(), 1e-12);
    double sum = 0;
    box.layout.for_cells([&](std::int64_t i) { sum += box.p[usize(i)]; });
    if (box.closed) {
      EXPECT_NEAR(sum, 0, 1e-10);
    }
    if (trial % 3 > 0) continue;
    PressureSolver<Real, D> multigrid(box.layout);
    multigrid.set_matrix(box.weights(), box.cells, 1);
    std::vector<double> p(box.p.size());
    const double tolerance = sizeof(Real) == 8 ? 1e-11 : 1e-6;
    const SolveReport other = multigrid.solve(box.b, p, tolerance, 100, 1);
    EXPECT_TRUE(other.converged);
    EXPECT_EQ(report.closed_regions, other.closed_regions);
    EXPECT_NEAR(report.imbalance, other.imbalance, 1e-6);
    double largest = 0, error = 0;
    box.layout.for_cells([&](std::int64_t i) {
      largest = std::max(largest, std::abs(p[usize(i)]));
      error = std::max(error, std::abs(p[usize(i)] - box.p[usize(i)]));
    });
    EXPECT_LE(error, 1e3 * tolerance * largest);
  }
}

TYPED_TEST(TransformSolverOf, what_is_not_fluid_keeps_its_zeros) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  std::array<int, D> n;
  std::array<LineEnds, D> ends;
  n.fill(7), ends.fill(LineEnds::kOpen);
  Box<Real, D> box(n, ends);
  box.solve();
  for (std::size_t i = 0; i < box.p.size(); ++i) {
    EXPECT_EQ(box.p[i] != 0, box.cells[i] == Cell::kFluid) << i;
  }
}

TYPED_TEST(TransformSolverOf, bits_do_not_depend_on_threads) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  std::array<int, D> n;
  std::array<LineEnds, D> ends;
  n.fill(D == 2 ? 210 : 49);
  ends.fill(LineEnds::kWalls), ends[1] = LineEnds::kWallOpen;
  Box<Real, D> box(n, ends);
  std::vector<std::vector<double>> found;
  std::vector<double> residuals;
  for (const int threads : {1, 2, 3}) {
    residuals.push_back(box.solve(threads).residual);
    found.push_back(box.p);
  }
  EXPECT_EQ(found[0], found[1]);
  EXPECT_EQ(found[0], found[2]);
  EXPECT_EQ(residuals[0], residuals[1]);
  EXPECT_EQ(residuals[0], residuals[2]);
}

TYPED_TEST(TransformSolverOf, a_number_that_is_not_finite_is_no_solution) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  std::array<int, D> n;
  std::array<LineEnds, D> ends;
  n.fill(6), ends.fill(LineEnds::kWalls);
  Box<Real, D> box(n, ends);
  box.b[usize(box.layout.first)] = std::numeric_limits<Real>::quiet_NaN();
  EXPECT_FALSE(box.solve().converged);
}

}  // namespace
