// The levels of multilevel position-based dynamics: what a coarser graph must be of a finer one.
#include "substep/pbd/solver/coarsening.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "substep/core/random.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::pbd;

double random_stiffness(std::uint64_t index) { return uniform2(7, index)[0]; }

// A jittered sheet with diagonals and unequal masses, held at two corners; after it a rope of its
// own and a particle that nothing holds.
DistanceGraph sheet(int n) {
  DistanceGraph graph;
  for (int i = 0; i < n * n; ++i) {
    graph.rest.push_back(
        {i % n + 0.5 * random_stiffness(2 * i), i / n + 0.5 * random_stiffness(2 * i + 1), 0});
    graph.mass.push_back(1 + random_stiffness(1000 + i));
  }
  graph.mass[0] = graph.mass[usize(n) - 1] = 0;
  const auto join = [&](std::int32_t i, std::int32_t j) {
    const auto &a = graph.rest[usize(i)], &b = graph.rest[usize(j)];
    graph.edges.push_back({i, j, std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2])});
  };
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      if (j + 1 < n) join(i * n + j, i * n + j + 1);
      if (i + 1 < n) join(i * n + j, (i + 1) * n + j);
      if (i + 1 < n && j + 1 < n) join(i * n + j, (i + 1) * n + j + 1);
    }
  }
  for (int i = 0; i < 20; ++i) {
    graph.rest.push_back({double(i), -5, 1});
    graph.mass.push_back(2);
    if (i > 0) join(n * n + i - 1, n * n + i);
  }
  graph.rest.push_back({0, 0, 9});
  graph.mass.push_back(1);
  find_directions(graph);
  return graph;
}

class Coarsened : public testing::Test {
 protected:
  // The numbers of the coarse particle that each fine one is, -1: none.
  std::vector<std::int32_t> representative() const {
    std::vector<std::int32_t> own(fine.rest.size(), -1);
    for (std::size_t k = 0; k < c.path.size(); ++k) {
      own[usize(c.path_points[k].front())] = c.coarse.edges[k].i;
      own[usize(c.path_points[k].back())] = c.coarse.edges[k].j;
    }
    return own;
  }
  DistanceGraph fine = sheet(24);
  Coarsening c = coarsen(fine);
};

TEST_F(Coarsened, IsMuchSmallerAndKeepsThePins) {
  EXPECT_LT(c.coarse.size(), fine.size() / 3);
  EXPECT_EQ(c.coarse.size() - c.coarse.free(), 2);
  EXPECT_EQ(c.coarse.rest[0], fine.rest[0]);
  EXPECT_EQ(c.coarse.rest[1], fine.rest[23]);
}

TEST_F(Coarsened, EveryParticleThatIsHeldFollows) {
  for (std::size_t i = 0; i + 1 < fine.rest.size(); ++i) {
    EXPECT_GT(c.followed.start[i + 1], c.followed.start[i]) << i;
  }
  EXPECT_EQ(c.followed.start[fine.rest.size()], c.followed.start[fine.rest.size() - 1]);
}

// M_I X_I = sum_i (m_i / k_i) x_i, the parts of all masses being all of the mass, but for what
// follows pins.
TEST_F(Coarsened, ParticlesAreCentresOfTheMassThatFollows) {
  double mass = 0, expected = 0;
  for (std::size_t at = 0; at < c.coarse.rest.size(); ++at) {
    double sum = 0;
    std::array<double, 3> centre{};
    for (auto k = usize(c.members.start[at]); k < usize(c.members.start[at + 1]); ++k) {
      sum += c.member_weight[k];
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const auto member = usize(c.members.index[k]);
        centre[axis] += c.member_weight[k] * fine.rest[member][axis];
      }
    }
    EXPECT_NEAR(sum, 1, 1e-14);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(c.coarse.rest[at][axis], centre[axis], 1e-13);
    }
    mass += c.coarse.mass[at];
  }
  for (std::size_t i = 0; i < fine.rest.size(); ++i) {
    for (auto k = c.followed.start[i]; k < c.followed.start[i + 1]; ++k) {
      const auto at = usize(c.followed.index[usize(k)]);
      if (c.coarse.mass[at] > 0) {
        expected += fine.mass[i] / (c.followed.start[i + 1] - c.followed.start[i]);
      }
    }
  }
  EXPECT_NEAR(mass, expected, 1e-10);
}

TEST_F(Coarsened, PathsLeadFromEndToEnd) {
  ASSERT_EQ(c.path.size(), c.coarse.edges.size());
  std::set<std::pair<std::int32_t, std::int32_t>> seen;
  const auto own = representative();
  for (std::size_t k = 0; k < c.path.size(); ++k) {
    const auto& edge = c.coarse.edges[k];
    EXPECT_LT(edge.i, edge.j);
    EXPECT_TRUE(seen.insert({edge.i, edge.j}).second);
    EXPECT_GT(edge.length, 0);
    EXPECT_EQ(own[usize(c.path_points[k].front())], edge.i);
    EXPECT_EQ(own[usize(c.path_points[k].back())], edge.j);
    for (std::size_t step = 0; step < Coarsening::kSteps; ++step) {
      const std::int32_t a = c.path_points[k][step], b = c.path_points[k][step + 1];
      if (c.path[k][step] < 0) {
        EXPECT_EQ(a, b);
        continue;
      }
      const auto& finer = fine.edges[usize(c.path[k][step])];
      EXPECT_EQ(std::minmax(a, b), std::minmax(finer.i, finer.j));
    }
  }
}

TEST_F(Coarsened, FreeCoarseParticlesAreNoNeighbours) {
  const auto own = representative();
  for (const auto& e : fine.edges) {
    const std::int32_t a = own[usize(e.i)], b = own[usize(e.j)];
    EXPECT_FALSE(a >= 0 && b >= 0) << e.i << " " << e.j;
  }
}

// The same sheet bent about a cylinder: edges are as long as if it lay flat, level after level.
TEST(Coarsening, BentSheetsAreLaidFlat) {
  const DistanceGraph flat = sheet(24);
  DistanceGraph bent = flat;
  constexpr double kRadius = 12;  // the sheet goes around by two radians
  for (std::size_t i = 0; i < 24 * 24; ++i) {
    auto& p = bent.rest[i];
    p = {kRadius * std::sin(p[0] / kRadius), p[1], kRadius * std::cos(p[0] / kRadius)};
  }
  find_directions(bent);
  Coarsening of_flat = coarsen(flat), of_bent = coarsen(bent);
  for (int level = 0; level < 2; ++level) {
    ASSERT_EQ(of_bent.coarse.edges.size(), of_flat.coarse.edges.size());
    for (std::size_t k = 0; k < of_flat.coarse.edges.size(); ++k) {
      const double expected = of_flat.coarse.edges[k].length;
      EXPECT_NEAR(of_bent.coarse.edges[k].length, expected, 0.02 * expected) << level << " " << k;
    }
    of_flat = coarsen(of_flat.coarse);
    of_bent = coarsen(of_bent.coarse);
  }
}

TEST(Coarsening, NothingIsJoinedAcrossACrease) {
  DistanceGraph graph = sheet(24);
  for (std::size_t i = 0; i < 24 * 24; ++i) {
    auto& p = graph.rest[i];
    if (p[0] > 12) p = {12, p[1], p[0] - 12};
  }
  find_directions(graph);
  const Coarsening once = coarsen(graph), twice = coarsen(once.coarse);
  for (const auto& e : twice.coarse.edges) {
    const auto &a = twice.coarse.rest[usize(e.i)], &b = twice.coarse.rest[usize(e.j)];
    EXPECT_FALSE((a[0] < 10 && b[2] > 2) || (b[0] < 10 && a[2] > 2)) << e.i << " " << e.j;
  }
}

TEST(Coarsening, WhereNothingIsJoinedNothingIsLeft) {
  DistanceGraph loose;
  loose.rest.assign(5, {0, 0, 0});
  loose.mass.assign(5, 1.0);
  EXPECT_EQ(coarsen(loose).coarse.size(), 0);
}

}  // namespace
