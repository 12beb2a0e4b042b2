#include "substep/pbf/boundary.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "substep/core/random.h"

namespace {

using namespace substep::pbf;
using substep::Point;
using substep::geometry::Box;
using substep::geometry::Collider;
using substep::geometry::Plane;
using substep::geometry::SampledDistance;
using substep::geometry::Sphere;

constexpr double kRadius = 0.1;  // h
constexpr double kInfinity = std::numeric_limits<double>::infinity();

DensityConstraint<double> constraint(int dimension) {
  DensityOptions options;
  options.dimension = dimension;
  options.spacing = kRadius / 2;
  return DensityConstraint<double>(options);
}
KernelFunction kernel_of(int dimension) {
  return [density = constraint(dimension)](double r) { return density.value(r); };
}

// The integral of W over the points that are inside, by the midpoint rule.
template <class Inside>
double integrate(const KernelFunction& kernel, int dimension, Inside&& inside) {
  const int n = dimension == 2 ? 800 : 100, deep = dimension == 2 ? 1 : n;
  const double step = 2 * kRadius / n;
  double sum = 0;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      for (int k = 0; k < deep; ++k) {
        const Vec3 x(step * (i + 0.5) - kRadius, step * (j + 0.5) - kRadius,
                     dimension == 2 ? 0 : step * (k + 0.5) - kRadius);
        if (x.norm() < kRadius && inside(x)) sum += kernel(x.norm());
      }
    }
  }
  return sum * std::pow(step, dimension);
}

class WallIntegrals : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Dimensions, WallIntegrals, testing::Values(2, 3));

TEST_P(WallIntegrals, HalfSpacesAndBallsAreThoseOfNumericalIntegration) {
  const int dimension = GetParam();
  const KernelFunction kernel = kernel_of(dimension);
  const DistanceTable plane(kernel, kRadius, dimension, kInfinity);
  const DistanceTable ball(kernel, kRadius, dimension, 0.15);
  for (const double d : {-0.07, -0.02, 0.012, 0.038, 0.08}) {
    const double half_space = integrate(kernel, dimension, [&](Vec3 x) { return x[0] < -d; });
    EXPECT_NEAR(plane(d).value, half_space, 3e-3);
    const double in_ball = integrate(
        kernel, dimension, [&](Vec3 x) { return (x + Vec3(0.15 + d, 0, 0)).norm() < 0.15; });
    EXPECT_NEAR(ball(d).value, in_ball, 3e-3);
    const double step = 1e-3;
    for (const DistanceTable* table : {&plane, &ball}) {
      const double slope = ((*table)(d + step).value - (*table)(d - step).value) / (2 * step);
      EXPECT_NEAR((*table)(d).slope, slope, 0.02 / kRadius);
    }
  }
}

TEST_P(WallIntegrals, BoxesAreThoseOfNumericalIntegration) {
  const int dimension = GetParam();
  const KernelFunction kernel = kernel_of(dimension);
  const CornerTable table(kernel, kRadius, dimension);
  const std::pair<Vec3, Vec3> boxes[] = {{{-1, -1, -1}, {0.03, 0.02, 0.05}},
                                         {{0.02, 0.03, 0.01}, {1, 1, 1}},
                                         {{-0.03, -0.02, 0.02}, {0.05, 0.02, 0.06}},
                                         {{0.01, -0.04, -1}, {0.04, 1, 0.02}}};
  for (const auto& [low, high] : boxes) {
    const auto inside = [&, low = low, high = high](Vec3 x) {
      for (int axis = 0; axis < dimension; ++axis) {
        if (x[axis] < low[axis] || x[axis] > high[axis]) return false;
      }
      return true;
    };
    EXPECT_NEAR(table.box(low, high).value, integrate(kernel, dimension, inside), 6e-3);
    for (int axis = 0; axis < dimension; ++axis) {
      const Vec3 step = 2e-3 * Vec3::Unit(axis);
      const auto box = table.box(low, high);
      const double by_low =
          (table.box(low + step, high).value - table.box(low - step, high).value) / 4e-3;
      const double by_high =
          (table.box(low, high + step).value - table.box(low, high - step).value) / 4e-3;
      EXPECT_NEAR(box.by_low[axis], by_low, 0.05 / kRadius);
      EXPECT_NEAR(box.by_high[axis], by_high, 0.05 / kRadius);
    }
  }
}

// Of a ball that is known exactly; with a grid twice as fine as the particles.
TEST(DensityMap, OfASampledBallIsThatOfTheBall) {
  const double radius = 0.35, spacing = 0.025;
  std::vector<double> values;
  constexpr int kNodes = 41;
  const double half = 0.5 * spacing * (kNodes - 1);
  for (int i = 0; i < kNodes; ++i) {
    for (int j = 0; j < kNodes; ++j) {
      for (int k = 0; k < kNodes; ++k) {
        const Vec3 at = spacing * Vec3(i, j, k) - Vec3::Constant(half);
        values.push_back(at.norm() - radius);
      }
    }
  }
  const SampledDistance field({kNodes, kNodes, kNodes}, Vec3::Constant(-half), spacing, values);
  const KernelFunction kernel = kernel_of(3);
  const DensityMap solid(field, false, kernel, kRadius, 1), vessel(field, true, kernel, kRadius, 2);
  const DistanceTable exact(kernel, kRadius, 3, radius);
  for (std::uint64_t i = 0; i < 300; ++i) {
    const auto a = substep::uniform2(3, i), b = substep::uniform2(4, i);
    const Vec3 n = Vec3(2 * a[0] - 1, 2 * a[1] - 1, 2 * b[0] - 1).normalized();
    const double d = kRadius * (2 * b[1] - 1);
    const WallDensity map = solid((radius + d) * n), outside = vessel((radius + d) * n);
    EXPECT_NEAR(map.value, exact(d).value, 0.015);
    EXPECT_NEAR((map.gradient - exact(d).slope * n).norm() * kRadius, 0, 0.12);  // of 1.4
    EXPECT_NEAR(outside.value, 1 - map.value, 1e-6);
    EXPECT_NEAR((outside.gradient + map.gradient).norm(), 0, 1e-6);
  }
}

// At half a spacing from a wall is the sum over the lattice that goes on behind it; the gradient is
// the derivative; and obstacles may be turned about.
TEST(Mirror, GoesOnWithTheLattice) {
  for (const int dimension : {2, 3}) {
    const auto density = constraint(dimension);
    const double spacing = kRadius / 2;
    const Mirror mirror(DistanceTable(kernel_of(dimension), kRadius, dimension, kInfinity), kRadius,
                        spacing, density.half_lattice());
    EXPECT_NEAR(mirror(spacing / 2).value, density.half_lattice(), 1e-3);
    EXPECT_EQ(mirror(mirror.reach()).value, 0);
    for (double s = 0.002; s < 0.049; s += 0.003) {
      const double step = 5e-4;
      EXPECT_NEAR(mirror(s).slope, (mirror(s + step).value - mirror(s - step).value) / (2 * step),
                  0.3);
      EXPECT_GT(mirror(s).value, mirror(s + 0.002).value);
    }
  }
}

TEST(Boundary, GradientsAreDerivativesForEveryShape) {
  const auto density = constraint(3);
  const substep::geometry::Quaternion turned(Eigen::AngleAxisd(0.7, Vec3(1, 2, -1).normalized()));
  Collider plane(Plane{{0, 0.6, 0.8}}, Vec3::Zero()), ball(Sphere{0.2}, {0.1, 0, 0}),
      bowl(Sphere{0.3}, {0, 0.1, 0}, true), tank(Box{{0.3, 0.2, 0.25}}, {0, 0, 0.1}, true),
      block(Box{{0.2, 0.1, 0.15}}, {0, 0.1, 0});
  for (Collider* collider : {&tank, &block}) collider->set_orientation(turned);
  for (const Collider& collider : {plane, ball, bowl, tank, block}) {
    Boundary<double> boundary({collider}, {}, density, Vec3::Zero(), 1);
    const auto value_at = [&](const Vec3& x) {
      const std::vector<Point<double>> points{{x[0], x[1], x[2], 1}};
      boundary.find_near(points, 1);
      return boundary.contributions(points, 1)[0];
    };
    int tested = 0;
    for (std::uint64_t i = 0; i < 4000 && tested < 40; ++i) {
      const auto a = substep::uniform2(5, i), b = substep::uniform2(6, i);
      const Vec3 x = 0.4 * Vec3(2 * a[0] - 1, 2 * a[1] - 1, 2 * b[0] - 1);
      const double d = collider.signed_distance(x).value;
      if (d < 0.01 || d > 0.045) continue;
      ++tested;
      const Point<double> here = value_at(x);
      EXPECT_GT(here.w, 0);
      const double step = 2e-3;
      Vec3 slope;
      for (int axis = 0; axis < 3; ++axis) {
        const Vec3 e = step * Vec3::Unit(axis);
        slope[axis] = (value_at(x + e).w - value_at(x - e).w) / (2 * step);
      }
      // The turn of the normal of a curved surface is left out: relative error d / radius.
      const Vec3 g(here.x, here.y, here.z);
      EXPECT_LT((g - slope).norm(), 0.2 * g.norm() + 0.4);
    }
    EXPECT_EQ(tested, 40);
  }
}

}  // namespace
