#include "substep/gridfluid/pressure/pressure_solver.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>
#include <string>

namespace {

using namespace substep::gridfluid;
using substep::usize;

template <class Real, int D>
struct Problem {
  explicit Problem(const Layout<D>& layout_)
      : layout(layout_),
        cells(usize(layout.size), Cell::kSolid),
        b(usize(layout.size), 0),
        p(usize(layout.size), 0) {
    for (auto& faces : w) faces.assign(usize(layout.size), 0);
  }
  PressureSolver<Real, D> solver(int threads = 1) const {
    PressureSolver<Real, D> made(layout);
    std::array<std::span<const Real>, usize(D)> spans;
    for (std::size_t a = 0; a < D; ++a) spans[a] = w[a];
    made.set_matrix(spans, cells, threads);
    return made;
  }
  SolveReport solve(double tolerance = 1e-6, int max_iterations = 50, int threads = 1) {
    return solver(threads).solve(b, p, tolerance, max_iterations, threads);
  }

  Layout<D> layout;
  std::vector<Cell> cells;
  std::array<std::vector<Real>, D> w;
  std::vector<Real> b;
  std::vector<double> p;
};

// use(cell) for the cells of a grid, and `ghosts` layers around.
template <int D>
void for_cells(const Layout<D>& layout, const std::function<void(const std::array<int, D>&)>& use,
               int ghosts = 0) {
  std::array<int, D> cell;
  const std::function<void(std::size_t)> along = [&](std::size_t a) {
    if (a == D) return use(cell);
    for (cell[a] = -ghosts; cell[a] < layout.cells[a] + ghosts; ++cell[a]) along(a + 1);
  };
  along(0);
}

// The cell below or above, on the other side if the axis is periodic.
template <int D>
std::int64_t beside(const Layout<D>& layout, std::array<int, D> cell, std::size_t a, int step) {
  cell[a] += step;
  if (layout.periodic[a]) cell[a] = (cell[a] + layout.cells[a]) % layout.cells[a];
  return layout.index(cell);
}

// w of the lower or upper face of a cell.
template <class Real, int D>
double face(const Problem<Real, D>& problem, const std::array<int, D>& cell, std::size_t a,
            int step) {
  const std::int64_t at = problem.layout.index(cell) + (step > 0 ? problem.layout.stride[a] : 0);
  return double(problem.w[a][usize(at)]);
}

// A problem of what stands where: w is `open` over theta, with the levels phi of the cells.
template <class Real, int D>
void set_faces(Problem<Real, D>& problem,
               const std::function<double(std::size_t, std::int64_t)>& open,
               const std::function<double(std::int64_t, std::int64_t)>& theta) {
  const Layout<D>& layout = problem.layout;
  for_cells<D>(
      layout,
      [&](const std::array<int, D>& cell) {
        for (std::size_t a = 0; a < D; ++a) {
          bool here = true;  // a face of the grid
          for (std::size_t e = 0; e < D; ++e)
            here = here && cell[e] >= 0 && (cell[e] < layout.cells[e] + (e == a));
          if (!here) continue;
          const std::int64_t i = layout.index(cell);
          std::array<int, D> inside = cell;
          if (layout.periodic[a]) inside[a] %= layout.cells[a];
          const std::int64_t upper = layout.index(inside), lower = beside<D>(layout, inside, a, -1);
          const Cell up = problem.cells[usize(upper)], down = problem.cells[usize(lower)];
          if (up == Cell::kSolid || down == Cell::kSolid) continue;
          double w = open(a, upper);
          if (up != down) w /= up == Cell::kFluid ? theta(upper, lower) : theta(lower, upper);
          problem.w[a][usize(i)] = static_cast<Real>(w);
        }
      },
      1);
}

// Cells and faces by chance.
template <class Real, int D>
Problem<Real, D> random_problem(unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::array<int, D> cells;
  std::array<bool, D> periodic;
  for (std::size_t a = 0; a < D; ++a) {
    cells[a] = 2 + static_cast<int>(uniform(generator) * (D == 2 ? 17 : 7));
    periodic[a] = uniform(generator) < 0.4;
  }
  Problem<Real, D> problem{Layout<D>(cells, periodic)};
  const double solids = 0.5 * uniform(generator), air = 0.2 * uniform(generator) * (seed % 3);
  for_cells<D>(
      problem.layout,
      [&](const std::array<int, D>& cell) {
        const double u = uniform(generator);
        const std::int64_t i = problem.layout.index(cell);
        if (i < 0 || i >= problem.layout.size) return;
        int outside = 0;
        for (std::size_t a = 0; a < D; ++a)
          outside += cell[a] < 0 || cell[a] >= problem.layout.cells[a];
        Cell& kind = problem.cells[usize(i)];
        if (outside == 0)
          kind = u < solids ? Cell::kSolid : u < solids + air ? Cell::kAir : Cell::kFluid;
        if (outside == 1) kind = u < 0.1 * (seed % 3) ? Cell::kAir : Cell::kSolid;
        if (outside == 0 && kind == Cell::kFluid)
          problem.b[usize(i)] = static_cast<Real>(uniform(generator) - 0.5);
      },
      1);
  std::vector<double> closed(usize(problem.layout.size)), thetas(closed.size());
  for (double& t : thetas) t = 0.01 + 0.99 * uniform(generator);
  std::array<std::vector<double>, D> open;
  for (auto& faces : open)
    for (std::size_t i = 0; i < thetas.size(); ++i)
      faces.push_back(uniform(generator) < 0.2 ? 0
                                               : std::max(1e-3, std::pow(uniform(generator), 3)));
  set_faces<Real, D>(
      problem, [&](std::size_t a, std::int64_t i) { return open[a][usize(i)]; },
      [&](std::int64_t i, std::int64_t) { return thetas[usize(i)]; });
  return problem;
}

// The matrix and its regions, cell by cell; the solution by LDL^T.
template <class Real, int D>
struct Dense {
  explicit Dense(const Problem<Real, D>& problem) {
    const Layout<D>& layout = problem.layout;
    std::vector<int> number(usize(layout.size), -1);
    for_cells<D>(layout, [&](const std::array<int, D>& cell) {
      const std::int64_t i = layout.index(cell);
      if (problem.cells[usize(i)] != Cell::kFluid) return;
      number[usize(i)] = static_cast<int>(index.size());
      index.push_back(i);
    });
    const auto n = static_cast<Eigen::Index>(index.size());
    a = Eigen::MatrixXd::Zero(n, n), b.resize(n);
    std::vector<bool> air(index.size());
    for_cells<D>(layout, [&](const std::array<int, D>& cell) {
      const int i = number[usize(layout.index(cell))];
      if (i < 0) return;
      b[i] = double(problem.b[usize(layout.index(cell))]);
      for (std::size_t axis = 0; axis < D; ++axis) {
        for (const int step : {-1, 1}) {
          const double w = face<Real, D>(problem, cell, axis, step);
          const int j = number[usize(beside<D>(layout, cell, axis, step))];
          a(i, i) += w;
          if (j >= 0) a(i, j) -= w;
          if (j < 0 && w > 0) air[usize(i)] = true;
        }
      }
    });
    region.assign(index.size(), -1);
    for (std::size_t i = 0; i < index.size(); ++i) {
      if (region[i] >= 0) continue;
      std::vector<std::size_t> stack{i}, members;
      bool open = false;
      region[i] = regions;
      while (!stack.empty()) {
        const std::size_t k = stack.back();
        stack.pop_back(), members.push_back(k);
        open = open || air[k];
        for (std::size_t j = 0; j < index.size(); ++j) {
          if (region[j] >= 0 || a(Eigen::Index(k), Eigen::Index(j)) == 0) continue;
          region[j] = regions, stack.push_back(j);
        }
      }
      ++regions;
      if (open) continue;
      ++closed;
      double sum = 0;
      for (const std::size_t k : members) sum += b[Eigen::Index(k)];
      const auto size = static_cast<double>(members.size());
      for (const std::size_t k : members) {
        b[Eigen::Index(k)] -= sum / size;
        for (const std::size_t j : members) singular.emplace_back(k, j);
      }
    }
  }
  Eigen::VectorXd solution() const {
    Eigen::MatrixXd regular = a;
    for (const auto& [i, j] : singular) regular(Eigen::Index(i), Eigen::Index(j)) += 1;
    return regular.ldlt().solve(b);
  }

  Eigen::MatrixXd a;
  Eigen::VectorXd b;
  std::vector<std::int64_t> index;
  std::vector<int> region;
  std::vector<std::pair<std::size_t, std::size_t>> singular;
  int regions = 0, closed = 0;
};

template <class T>
struct PressureSolverOf : testing::Test {};
template <class Real_, int kDimension>
struct Kind {
  using Real = Real_;
  static constexpr int D = kDimension;
};
using Kinds = testing::Types<Kind<float, 2>, Kind<float, 3>, Kind<double, 2>, Kind<double, 3>>;
TYPED_TEST_SUITE(PressureSolverOf, Kinds);

TYPED_TEST(PressureSolverOf, small_problems_by_chance_are_solved_as_by_elimination) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  for (unsigned seed = 0; seed < 200; ++seed) {
    auto problem = random_problem<Real, D>(seed);
    const Dense<Real, D> dense(problem);
    // (b without its means is rounded to Real.)
    const double tolerance = sizeof(Real) == 8 ? 1e-10 : 1e-6;
    const SolveReport report = problem.solve(tolerance, 100);
    ASSERT_TRUE(report.converged) << seed << ' ' << report.iterations << ' ' << report.residual;
    EXPECT_EQ(report.closed_regions, dense.closed) << seed;
    const Eigen::VectorXd expected = dense.solution();
    Eigen::VectorXd found(expected.size());
    for (Eigen::Index i = 0; i < found.size(); ++i)
      found[i] = problem.p[usize(dense.index[usize(i)])];
    if (dense.b.size() == 0) continue;
    EXPECT_LE((dense.a * found - dense.b).norm(), 2 * tolerance * dense.b.norm()) << seed;
    // In the norm of A, which weak links do not spoil.
    const Eigen::VectorXd error = found - expected;
    EXPECT_LE(std::sqrt(std::abs(error.dot(dense.a * error))),
              100 * tolerance * std::sqrt(std::abs(expected.dot(dense.a * expected))) + 1e-12)
        << seed;
  }
}

TYPED_TEST(PressureSolverOf, cells_without_an_open_face_have_no_pressure) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  std::array<int, D> cells;
  cells.fill(6);
  Problem<Real, D> problem{Layout<D>(cells)};
  for_cells<D>(problem.layout, [&](const std::array<int, D>& cell) {
    problem.cells[usize(problem.layout.index(cell))] = Cell::kFluid;
    problem.p[usize(problem.layout.index(cell))] = 7;
  });
  const SolveReport report = problem.solve();
  EXPECT_TRUE(report.converged);
  EXPECT_EQ(report.closed_regions, problem.layout.count());
  for (const double p : problem.p) EXPECT_EQ(p, 0);
}

// Level sets in a box of n cells along each axis, 1 long: water is where `water` is below 0, solid
// where `solid` is; air is above the last axis, or nothing.
template <int D>
using PlaceOf = std::array<double, usize(D)>;
template <int D>
using LevelSet = std::function<double(const PlaceOf<D>&)>;

template <class Real, int D>
Problem<Real, D> tank(int n, bool open_top, const LevelSet<D>& water, const LevelSet<D>& solid) {
  std::array<int, D> cells;
  cells.fill(n);
  Problem<Real, D> problem{Layout<D>(cells)};
  const Layout<D>& layout = problem.layout;
  const double h = 1.0 / n;
  const auto centre = [&](const std::array<int, D>& cell) {
    PlaceOf<D> x;
    for (std::size_t a = 0; a < D; ++a) x[a] = (cell[a] + 0.5) * h;
    return x;
  };
  std::mt19937 generator(5);
  std::uniform_real_distribution<double> uniform(-0.5, 0.5);
  std::vector<double> phi(usize(layout.size), h / 2);
  std::array<std::vector<double>, D> open;
  for (auto& faces : open) faces.assign(usize(layout.size), 1);
  for_cells<D>(
      layout,
      [&](const std::array<int, D>& cell) {
        int outside = 0;
        for (std::size_t a = 0; a < D; ++a) outside += cell[a] < 0 || cell[a] >= n;
        if (outside > 1 || (outside == 1 && cell[D - 1] != n)) return;
        const auto i = usize(layout.index(cell));
        if (outside == 1) {
          problem.cells[i] = open_top ? Cell::kAir : Cell::kSolid;
          return;
        }
        phi[i] = water ? water(centre(cell)) : -h / 2;
        problem.cells[i] = phi[i] < 0 ? Cell::kFluid : Cell::kAir;
        if (!solid) return;
        if (solid(centre(cell)) < -h) problem.cells[i] = Cell::kSolid;
        for (std::size_t a = 0; a < D; ++a) {
          PlaceOf<D> x = centre(cell);
          x[a] -= h / 2;
          if (std::abs(solid(x)) > h) {
            open[a][i] = solid(x) > 0;
            continue;
          }
          constexpr int kSamples = 8;  // along each axis of the face
          int inside = 0, all = 1;
          for (std::size_t e = 1; e < D; ++e) all *= kSamples;
          for (int k = 0; k < all; ++k) {
            PlaceOf<D> y = x;
            for (std::size_t e = 0, rest = usize(k); e < D; ++e) {
              if (e == a) continue;
              y[e] += (double(rest % kSamples + 0.5) / kSamples - 0.5) * h;
              rest /= kSamples;
            }
            inside += solid(y) > 0;
          }
          open[a][i] = double(inside) / all;
        }
      },
      1);
  set_faces<Real, D>(
      problem, [&](std::size_t a, std::int64_t i) { return open[a][usize(i)]; },
      [&](std::int64_t i, std::int64_t j) {
        return std::max(phi[usize(i)] / (phi[usize(i)] - phi[usize(j)]), 0.01);
      });
  for_cells<D>(layout, [&](const std::array<int, D>& cell) {
    const auto i = usize(layout.index(cell));
    double sum = 0;
    for (std::size_t a = 0; a < D; ++a)
      sum += face<Real, D>(problem, cell, a, -1) + face<Real, D>(problem, cell, a, 1);
    if (problem.cells[i] == Cell::kFluid && sum > 0)
      problem.b[i] = static_cast<Real>(uniform(generator));
  });
  return problem;
}

template <int D>
LevelSet<D> ball(const PlaceOf<D>& centre, double radius) {
  return [=](const PlaceOf<D>& x) {
    double sum = 0;
    for (std::size_t a = 0; a < D; ++a) sum += (x[a] - centre[a]) * (x[a] - centre[a]);
    return std::sqrt(sum) - radius;
  };
}

// A wavy pool and many drops above.
template <int D>
LevelSet<D> splash() {
  std::mt19937 generator(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<std::pair<PlaceOf<D>, double>> drops;
  for (int k = 0; k < (D == 2 ? 60 : 300); ++k) {
    PlaceOf<D> x;
    for (double& c : x) c = uniform(generator);
    x[D - 1] = 0.55 + 0.4 * x[D - 1] * x[D - 1];
    drops.emplace_back(x, 0.012 + 0.05 * std::pow(uniform(generator), 3));
  }
  return [drops](const PlaceOf<D>& x) {
    double phi = x[D - 1] - (0.6 + 0.05 * std::sin(9 * x[0]) * std::cos(7 * x[D - 2] + 1));
    for (const auto& [centre, radius] : drops) {
      double rr = 0;
      for (std::size_t a = 0; a < D; ++a) rr += (x[a] - centre[a]) * (x[a] - centre[a]);
      if (phi + radius > 0 && rr < (phi + radius) * (phi + radius)) phi = std::sqrt(rr) - radius;
    }
    return phi;
  };
}

template <int D>
LevelSet<D> sunken_ball() {
  PlaceOf<D> centre;
  centre.fill(0.5);
  centre[D - 1] = 0.35;
  return ball<D>(centre, 0.21);
}

TYPED_TEST(PressureSolverOf, ten_iterations_do_at_any_size) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  for (const int n : D == 2 ? std::vector{64, 256, 1024} : std::vector{32, 64, 128}) {
    if (sizeof(Real) == 8 && n > 512 / (D * D - 3)) continue;
    const auto iterations = [&](bool open, const LevelSet<D>& water, const LevelSet<D>& solid) {
      auto problem = tank<Real, D>(n, open, water, solid);
      const SolveReport report = problem.solve(1e-6, 50, 2);
      EXPECT_TRUE(report.converged);
      EXPECT_EQ(report.preconditioner, Preconditioner::kMultigrid);
      return report.iterations;
    };
    EXPECT_LE(iterations(false, nullptr, nullptr), 9) << n;
    EXPECT_LE(iterations(true, nullptr, nullptr), 9) << n;
    EXPECT_LE(iterations(true, splash<D>(), sunken_ball<D>()), 10) << n;
  }
}

TYPED_TEST(PressureSolverOf, bits_do_not_depend_on_threads) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  auto problem = tank<Real, D>(D == 2 ? 301 : 97, true, splash<D>(), sunken_ball<D>());
  std::vector<std::vector<double>> found;
  for (const int threads : {1, 2, 3}) {
    std::fill(problem.p.begin(), problem.p.end(), 0.0);
    EXPECT_TRUE(problem.solve(1e-8, 50, threads).converged);
    found.push_back(problem.p);
  }
  EXPECT_EQ(found[0], found[1]);
  EXPECT_EQ(found[0], found[2]);
}

// What stands where there was fluid once, and is none, must not be seen.
TYPED_TEST(PressureSolverOf, a_solver_of_other_domains_before_solves_as_a_new_one) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  PlaceOf<D> low, high;
  low.fill(0.3), high.fill(0.72);
  const auto both = [&](const PlaceOf<D>& x) {
    return std::min(ball<D>(low, 0.17)(x), ball<D>(high, 0.21)(x));
  };
  const auto none = [](const PlaceOf<D>&) { return 1.0; };
  auto solver = tank<Real, D>(48, true, splash<D>(), nullptr).solver();
  for (const LevelSet<D>& water : {splash<D>(), ball<D>(low, 0.2), LevelSet<D>(both),
                                   ball<D>(high, 0.1), LevelSet<D>(none), splash<D>()}) {
    auto problem = tank<Real, D>(48, true, water, nullptr);
    const std::vector<double> start(problem.p.size(), 3.0);  // also where there is no fluid
    problem.p = start;
    const SolveReport alone = problem.solve(1e-6);
    const std::vector<double> expected = std::exchange(problem.p, start);
    std::array<std::span<const Real>, usize(D)> w;
    for (std::size_t a = 0; a < D; ++a) w[a] = problem.w[a];
    solver.set_matrix(w, problem.cells, 1);
    const SolveReport again = solver.solve(problem.b, problem.p, 1e-6, 50, 1);
    EXPECT_EQ(again.iterations, alone.iterations);
    EXPECT_EQ(problem.p, expected);
  }
}

TYPED_TEST(PressureSolverOf, a_solution_is_a_first_guess_that_needs_no_iteration) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  auto problem = tank<Real, D>(24, false, nullptr, sunken_ball<D>());
  auto solver = problem.solver();
  EXPECT_GT(solver.solve(problem.b, problem.p, 1e-8, 50).iterations, 5);
  const std::vector<double> before = problem.p;
  const SolveReport report = solver.solve(problem.b, problem.p, 1e-7, 50);
  EXPECT_EQ(report.iterations, 0);
  EXPECT_TRUE(report.converged);
  // A bad one does no harm.
  for (double& p : problem.p) p = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(solver.solve(problem.b, problem.p, 1e-6, 10).converged);
}

TYPED_TEST(PressureSolverOf, too_few_iterations_and_inflow_without_outflow_are_reported) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  auto problem = tank<Real, D>(24, false, nullptr, nullptr);
  const SolveReport few = problem.solve(1e-6, 2);
  EXPECT_FALSE(few.converged);
  EXPECT_EQ(few.iterations, 2);
  EXPECT_GT(few.residual, 1e-6);
  EXPECT_LT(few.imbalance, 0.05);
  for (Real& b : problem.b) b = std::abs(b);
  EXPECT_NEAR(problem.solve().imbalance, 1, 1e-6);
}

// Still water, n cells deep: the divergence of g dt is at the bottom and at the surface only.
TYPED_TEST(PressureSolverOf, still_water_has_its_own_pressure_at_any_depth) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  std::array<int, D> cells;
  cells.fill(6);
  cells[D - 1] = 256;
  Problem<Real, D> problem{Layout<D>(cells)};
  const double h = 0.01, theta = 0.3;
  for_cells<D>(problem.layout, [&](const std::array<int, D>& cell) {
    const auto i = usize(problem.layout.index(cell));
    problem.cells[i] = cell[D - 1] < 250 ? Cell::kFluid : Cell::kAir;
    // sum of w (p_i - p_j) for p = 9.81 * 1000 * depth: theta h below the surface at the top.
    if (cell[D - 1] == 0) problem.b[i] = static_cast<Real>(9810 * h);
    if (cell[D - 1] == 249) problem.b[i] = 0;
  });
  set_faces<Real, D>(
      problem, [](std::size_t, std::int64_t) { return 1.0; },
      [&](std::int64_t, std::int64_t) { return theta; });
  const SolveReport report = problem.solve();
  EXPECT_TRUE(report.converged);
  EXPECT_LE(report.iterations, 10);
  for_cells<D>(problem.layout, [&](const std::array<int, D>& cell) {
    if (cell[D - 1] >= 250) return;
    const double depth = (249 - cell[D - 1] + theta) * h;
    EXPECT_NEAR(problem.p[usize(problem.layout.index(cell))], 9810 * depth, 9810 * 2.5 * 2e-5);
  });
}

// Gibou et al. 2002, section 4: -lap p = f in a ball, p = 0 on it, of second order in the maximum.
TYPED_TEST(PressureSolverOf, a_curved_surface_is_found_to_second_order) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  for (const int n : {16, 32, 64, 128}) {
    if (D == 3 && n > 64) continue;
    PlaceOf<D> centre;
    centre.fill(0.48);
    const double radius = 0.37;
    auto problem = tank<Real, D>(n, false, ball<D>(centre, radius), nullptr);
    const double h = 1.0 / n;
    // p = (R^2 - r^2) (1 + x): -lap p = 2 D (1 + x) + 4 (x - c), x along the first axis.
    const auto at = [&](const std::array<int, D>& cell) {
      double rr = 0;
      for (std::size_t a = 0; a < D; ++a) rr += std::pow((cell[a] + 0.5) * h - centre[a], 2);
      return std::pair((cell[0] + 0.5) * h, rr);
    };
    for_cells<D>(problem.layout, [&](const std::array<int, D>& cell) {
      const auto i = usize(problem.layout.index(cell));
      const double x = at(cell).first;
      if (problem.cells[i] == Cell::kFluid)
        problem.b[i] = static_cast<Real>(h * h * (2 * D * (1 + x) + 4 * (x - centre[0])));
    });
    EXPECT_TRUE(problem.solve(1e-7).converged);
    double error = 0;
    for_cells<D>(problem.layout, [&](const std::array<int, D>& cell) {
      const auto i = usize(problem.layout.index(cell));
      const auto [x, rr] = at(cell);
      if (problem.cells[i] == Cell::kFluid)
        error = std::max(error, std::abs(problem.p[i] - (radius * radius - rr) * (1 + x)));
    });
    EXPECT_LT(error, 0.65 * h * h) << n;
  }
}

}  // namespace
