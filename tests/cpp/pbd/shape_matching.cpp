#include "substep/pbd/groups/shape_matching.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <numeric>

#include "substep/core/random.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::pbd;
using Points = std::vector<Point<double>>;

double random_place(std::uint64_t stream, std::uint64_t index) {
  return 2 * uniform2(stream, index)[0] - 1;
}

// Particles of masses 1 to 2 at random places, and one row that is empty.
Points random_points(std::size_t count, std::uint64_t seed) {
  Points x(count + 1);
  for (std::size_t i = 0; i < count; ++i) {
    x[i] = {random_place(seed, 4 * i), random_place(seed, 4 * i + 1), random_place(seed, 4 * i + 2),
            1 / (1.5 + 0.5 * random_place(seed, 4 * i + 3))};
  }
  return x;
}

Eigen::Vector3d at(const Point<double>& p) { return {p.x, p.y, p.z}; }

void place(Point<double>& p, const Eigen::Vector3d& to) { p.x = to[0], p.y = to[1], p.z = to[2]; }

Eigen::Matrix3d rotation() {
  return Eigen::AngleAxisd(2.5, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
}

Partition one_patch(std::size_t count) {
  Partition p;
  p.id.resize(count);
  std::iota(p.id.begin(), p.id.end(), 0);
  p.slot = p.id;
  p.patch_start = {0, static_cast<std::int64_t>(count)};
  return p;
}

// Clusters of consecutive members, with these rest positions.
Clusters clusters(const Points& rest, const std::vector<std::vector<std::int32_t>>& members,
                  double compliance = 0, double linear = 0) {
  Clusters k;
  k.start.push_back(0);
  for (const auto& list : members) {
    for (const std::int32_t i : list) {
      const auto& q = rest[usize(i)];
      k.particle.push_back(i);
      k.rest.push_back({q.x, q.y, q.z});
    }
    k.start.push_back(static_cast<std::int64_t>(k.particle.size()));
    k.compliance.push_back(compliance);
    k.damping.push_back(0);
    k.stiffness.push_back(1);
  }
  k.linear = linear;
  return k;
}

struct Solver {
  ShapeMatching<double> group;
  Points x, x_old;
  std::size_t count;
  double h = 0.01;

  Solver(const Clusters& k, const Points& start)
      : group(k), x(start), x_old(start), count(start.size() - 1) {
    group.attach(one_patch(count));
  }
  Sweep<double> sweep(int iteration) {
    Sweep<double> s{};
    s.x = x.data();
    s.x_old = x_old.data();
    s.count = static_cast<std::int64_t>(count);
    s.h = h;
    s.substeps = 1;
    s.iteration = iteration;
    s.iterations = iteration + 1;
    s.relaxation = 1;
    return s;
  }
  std::int64_t project(int iteration = 0) {
    std::int64_t skipped = 0;
    for (int phase = 0; phase < group.phases(); ++phase) {
      for (std::int64_t chunk = 0; chunk < group.chunks(phase); ++chunk) {
        skipped += group.project(phase, chunk, sweep(iteration));
      }
    }
    return skipped;
  }
  std::vector<double> values() {
    std::vector<double> c(usize(group.size()));
    group.values(sweep(0), c);
    return c;
  }
};

std::vector<std::int32_t> first(std::int32_t count) {
  std::vector<std::int32_t> list(usize(count));
  std::iota(list.begin(), list.end(), 0);
  return list;
}

double distance(const Points& a, const Points& b) {
  double most = 0;
  for (std::size_t i = 0; i < a.size(); ++i) most = std::max(most, (at(a[i]) - at(b[i])).norm());
  return most;
}

TEST(ShapeMatching, RigidMotionsAreAtRest) {
  const Points rest = random_points(20, 1);
  Points moved = rest;
  for (auto& p : moved) place(p, rotation() * at(p) + Eigen::Vector3d(3, 4, 5));
  Solver solver(clusters(rest, {first(20)}), moved);
  EXPECT_EQ(solver.project(), 0);
  EXPECT_LE(distance(solver.x, moved), 1e-13);
  EXPECT_LE(solver.values()[0], 1e-13);
}

TEST(ShapeMatching, ValueIsTheLeastDistanceFromAllRigidMotions) {
  const Points rest = random_points(12, 2), x = random_points(12, 3);
  Solver solver(clusters(rest, {first(12)}), x);
  const double c = solver.values()[0];
  solver.project();
  double square = 0;
  for (std::size_t i = 0; i < 12; ++i)
    square += (at(x[i]) - at(solver.x[i])).squaredNorm() / x[i].w;
  EXPECT_NEAR(c, std::sqrt(square), 1e-13);
  EXPECT_LE(solver.values()[0], 1e-13);
  // Any other rotation about the common centre of mass is further away.
  Eigen::Vector3d centre(0, 0, 0);
  double mass = 0;
  for (std::size_t i = 0; i < 12; ++i) centre += at(x[i]) / x[i].w, mass += 1 / x[i].w;
  centre /= mass;
  for (std::uint64_t seed = 0; seed < 30; ++seed) {
    const Eigen::Vector3d axis(random_place(seed, 0), random_place(seed, 1), random_place(seed, 2));
    const Eigen::Matrix3d turn =
        Eigen::AngleAxisd(0.2 * axis.norm(), axis.normalized()).toRotationMatrix();
    double other = 0;
    for (std::size_t i = 0; i < 12; ++i) {
      const Eigen::Vector3d g = centre + turn * (at(solver.x[i]) - centre);
      other += (at(x[i]) - g).squaredNorm() / x[i].w;
    }
    EXPECT_GT(other, square);
  }
}

TEST(ShapeMatching, GradientIsThatOfFiniteDifferences) {
  // A projection moves particles by -C w dC/dx.
  const Points rest = random_points(6, 4), x = random_points(6, 5);
  Solver solver(clusters(rest, {first(6)}), x);
  const double c = solver.values()[0], h = 1e-5;
  Solver projected = solver;
  projected.project();
  for (std::size_t i = 0; i < 6; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      Solver up = solver, down = solver;
      Eigen::Vector3d shift(0, 0, 0);
      shift[axis] = h;
      place(up.x[i], at(x[i]) + shift);
      place(down.x[i], at(x[i]) - shift);
      const double slope = (up.values()[0] - down.values()[0]) / (2 * h);
      EXPECT_NEAR((at(x[i]) - at(projected.x[i]))[axis], c * x[i].w * slope, 1e-8);
    }
  }
}

TEST(ShapeMatching, KeepsLinearAndAngularMomentum) {
  for (const double linear : {0.0, 0.7}) {
    const Points rest = random_points(15, 6), x = random_points(15, 7);
    Solver solver(clusters(rest, {first(15)}, 1e-4, linear), x);
    solver.project();
    Eigen::Vector3d momentum(0, 0, 0), angular(0, 0, 0);
    for (std::size_t i = 0; i < 15; ++i) {
      const Eigen::Vector3d change = (at(solver.x[i]) - at(x[i])) / x[i].w;
      momentum += change;
      angular += at(x[i]).cross(change);
    }
    EXPECT_GT(distance(solver.x, x), 0.01);
    EXPECT_LE(momentum.norm(), 1e-13);
    EXPECT_LE(angular.norm(), 1e-13);
  }
}

TEST(ShapeMatching, AReflectedClusterTurnsBack) {
  const Points rest = random_points(9, 8);
  Points mirrored = rest;
  for (auto& p : mirrored) p.z = -p.z;
  Solver solver(clusters(rest, {first(9)}), mirrored);
  solver.project();
  for (std::size_t i = 0; i < 9; ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      EXPECT_NEAR((at(solver.x[i]) - at(solver.x[j])).norm(), (at(rest[i]) - at(rest[j])).norm(),
                  1e-13);
    }
  }
  const auto handedness = [](const Points& x) {
    return (at(x[1]) - at(x[0])).cross(at(x[2]) - at(x[0])).dot(at(x[3]) - at(x[0]));
  };
  EXPECT_NEAR(handedness(solver.x), handedness(rest), 1e-12);
}

TEST(ShapeMatching, LinearClustersKeepAStretchOfTheSameVolume) {
  const Points rest = random_points(10, 9);
  Points stretched = rest;
  for (auto& p : stretched) p.x *= 1.6, p.y /= 1.6;
  Solver linear(clusters(rest, {first(10)}, 0, 1.0), stretched);
  linear.project();
  EXPECT_LE(distance(linear.x, stretched), 1e-13);
  Points grown = rest;  // a uniform stretch is undone
  for (auto& p : grown) p.x *= 2, p.y *= 2, p.z *= 2;
  Solver volume(clusters(rest, {first(10)}, 0, 1.0), grown);
  EXPECT_GT(volume.values()[0], 1);
  volume.project();
  EXPECT_LE(volume.values()[0], 1e-12);
}

TEST(ShapeMatching, ComplianceDoesNotDependOnIterations) {
  const Points rest = random_points(10, 10), x = random_points(10, 11);
  Solver once(clusters(rest, {first(10)}, 3e-4), x);
  once.project();
  Solver often = once;
  for (int iteration = 1; iteration < 10; ++iteration) often.project(iteration);
  EXPECT_LE(distance(once.x, often.x), 1e-12);
  // One step of implicit Euler of springs m / alpha: x - g shrinks by 1 / (1 + h^2 / alpha).
  const double start = Solver(clusters(rest, {first(10)}), x).values()[0];
  EXPECT_NEAR(once.values()[0], start / (1 + once.h * once.h / 3e-4), 1e-12);
}

TEST(ShapeMatching, PinnedParticlesStayAndTheOthersComeToThem) {
  const Points rest = random_points(8, 12);
  Points x = random_points(8, 13);
  for (const std::size_t i : {0u, 1u, 2u}) {
    place(x[i], rotation() * at(rest[i]));
    x[i].w = 0;
  }
  Solver solver(clusters(rest, {first(8)}), x);
  for (int iteration = 0; iteration < 200; ++iteration) solver.project(iteration);
  for (std::size_t i = 0; i < 8; ++i) {
    EXPECT_LE((at(solver.x[i]) - rotation() * at(rest[i])).norm(), 1e-9);
  }
  for (const std::size_t i : {0u, 1u, 2u}) EXPECT_EQ(at(solver.x[i]), at(x[i]));
}

TEST(ShapeMatching, DegenerateClustersGiveFiniteNumbers) {
  for (const double linear : {0.0, 0.5, 1.0}) {
    for (int kind = 0; kind < 6; ++kind) {
      SCOPED_TRACE(kind);
      Points rest = random_points(8, 14), x = random_points(8, 15);
      for (std::size_t i = 0; i < 8; ++i) {
        if (kind == 0) place(x[i], {1, 1, 1});
        if (kind == 1) place(rest[i], {1, 1, 1});
        if (kind == 2) x[i].z = 0;
        if (kind == 3) rest[i].z = rest[i].y = 0;
        if (kind == 4) x[i].y = x[i].z = 0;
        if (kind == 5) place(x[i], 1e6 * at(x[i]));
      }
      Solver solver(clusters(rest, {first(8)}, 0, linear), x);
      EXPECT_EQ(solver.project(), 0);
      for (std::size_t i = 0; i < 8; ++i) EXPECT_TRUE(at(solver.x[i]).allFinite());
    }
  }
  Points x = random_points(3, 16);
  for (auto& p : x) p.w = 0;
  EXPECT_EQ(Solver(clusters(x, {first(3)}), random_points(3, 17)).project(), 0);
  EXPECT_EQ(Solver(clusters(random_points(3, 17), {first(3)}), x).project(), 1);  // all pinned
  EXPECT_EQ(Solver(clusters(random_points(3, 17), {{1}}), x).project(), 1);
}

TEST(ShapeMatching, OverlappingClustersAreColouredAndLanesDoNotMatter) {
  constexpr std::int32_t kCount = 300;
  const Points rest = random_points(kCount, 18), x = random_points(kCount, 19);
  std::vector<std::vector<std::int32_t>> apart, chain, star;
  for (std::int32_t i = 0; i + 3 < kCount; i += 4) apart.push_back({i, i + 1, i + 2, i + 3});
  for (std::int32_t i = 0; i + 3 < kCount; ++i) chain.push_back({i, i + 1, i + 2, i + 3});
  for (std::int32_t i = 1; i <= 100; ++i) star.push_back({0, i, i + 100});
  Solver all(clusters(rest, apart), x);
  EXPECT_EQ(all.group.phases(), 1);
  all.project();
  for (std::size_t k = 0; k < apart.size(); k += 7) {
    Solver alone(clusters(rest, {apart[k]}), x);
    alone.project();
    for (const std::int32_t i : apart[k]) {
      const auto s = usize(i);
      EXPECT_EQ(at(alone.x[s]), at(all.x[s]));
    }
  }
  EXPECT_EQ(Solver(clusters(rest, chain), x).group.phases(), 4);
  EXPECT_EQ(Solver(clusters(rest, star), x).group.phases(), 100);
}

}  // namespace
