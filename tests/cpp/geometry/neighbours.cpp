#include "substep/geometry/neighbours.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using substep::InputError;
using substep::Point;
using substep::geometry::Neighbours;
using substep::geometry::Pairs;

template <class Real>
using Points = std::vector<Point<Real>>;

template <class Real>
Points<Real> random_points(int n, Real size, int dimension, Real about = 0) {
  std::mt19937 generator(7);
  std::uniform_real_distribution<Real> draw(about - size / 2, about + size / 2);
  Points<Real> x(usize(n));
  for (auto& p : x) p = {draw(generator), draw(generator), dimension == 3 ? draw(generator) : 1, 0};
  return x;
}

// Sorts, searches, and compares each list with all pairs.
template <class Real>
std::int64_t check(Neighbours<Real>& near, const Points<Real>& x, Real radius, Pairs pairs,
                   int threads = 0) {
  near.sort(x, radius, threads);
  const auto n = static_cast<std::int32_t>(x.size());
  Points<Real> sorted;
  std::vector<bool> seen(x.size());
  for (const std::int32_t i : near.order()) {
    EXPECT_FALSE(seen.at(usize(i)));
    seen[usize(i)] = true;
    sorted.push_back(x[usize(i)]);
  }
  EXPECT_EQ(sorted.size(), x.size());
  near.find(sorted, radius, pairs, threads);
  std::int64_t count = 0;
  for (std::int32_t i = 0; i < n; ++i) {
    std::vector<std::int32_t> expected;
    const Point<Real>& p = sorted[usize(i)];
    for (std::int32_t j = pairs == Pairs::kHalf ? i + 1 : 0; j < n; ++j) {
      const Point<Real>& q = sorted[usize(j)];
      const double dx = double{p.x} - q.x, dy = double{p.y} - q.y, dz = double{p.z} - q.z;
      if (j != i && dx * dx + dy * dy + dz * dz < double{radius} * radius) expected.push_back(j);
    }
    const auto list = near[i];
    EXPECT_EQ(std::vector(list.indices, list.indices + list.count), expected) << "of " << i;
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(list.indices) % 64, 0u);
    for (std::int32_t k = list.count; k < list.padded(); ++k) EXPECT_EQ(list.indices[k], n);
    count += list.count;
  }
  EXPECT_EQ(near.pair_count(), count);
  return count;
}

template <class Real>
class NeighboursOf : public testing::Test {};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(NeighboursOf, Reals);

TYPED_TEST(NeighboursOf, AllPairs) {
  using Real = TypeParam;
  for (const int dimension : {2, 3}) {
    Neighbours<Real> near(dimension);  // used again: what it holds fits other sizes
    for (const int n : {1500, 0, 1, 2, 15, 16, 17, 400}) {
      const auto x = random_points<Real>(n, 1, dimension);
      const auto full = check<Real>(near, x, Real(0.2), Pairs::kFull, 2);
      const auto half = check<Real>(near, x, Real(0.2), Pairs::kHalf, 3);
      EXPECT_EQ(full, 2 * half);
      EXPECT_GE(half, n == 1500 ? 10000 : 0);
      check<Real>(near, x, Real(3), Pairs::kFull);      // one cell
      check<Real>(near, x, Real(0.002), Pairs::kFull);  // more cells than a table may have
    }
  }
}

TYPED_TEST(NeighboursOf, PointsOfACellKeepTheirOrder) {
  using Real = TypeParam;
  Neighbours<Real> near;
  Points<Real> x;
  for (int i = 0; i < 100; ++i) x.push_back({Real(i % 2 ? 5.5 : 0.5), 0, 0, 0});
  near.sort(x, 1);
  for (int k = 0; k < 100; ++k) {
    EXPECT_EQ(near.order()[usize(k)], k < 50 ? 2 * k : 2 * (k - 50) + 1);
  }
}

TYPED_TEST(NeighboursOf, ASmallerRadiusThanTheCells) {
  using Real = TypeParam;
  Neighbours<Real> near;
  near.sort(Points<Real>{{0, 0, 0, 0}, {Real(0.5), 0, 0, 0}, {Real(0.75), 0, 0, 0}}, 1);
  const Points<Real> sorted{{0, 0, 0, 0}, {Real(0.5), 0, 0, 0}, {Real(0.75), 0, 0, 0}};
  near.find(sorted, Real(0.5));  // a distance of exactly the radius is not closer than it
  EXPECT_EQ(near[0].count, 0);
  EXPECT_EQ(near[1].count, 1);
  EXPECT_EQ(near[1].indices[0], 2);
  EXPECT_THROW(near.find(sorted, Real(1.5)), InputError);
}

TYPED_TEST(NeighboursOf, CoincidentPoints) {
  using Real = TypeParam;
  Neighbours<Real> near;
  const Points<Real> x(500, {Real(0.3), Real(-7), Real(1e3), 0});
  EXPECT_EQ(check<Real>(near, x, Real(0.1), Pairs::kFull), 500 * 499);
  EXPECT_EQ(check<Real>(near, x, Real(0.1), Pairs::kHalf), 500 * 499 / 2);
}

TYPED_TEST(NeighboursOf, CrowdedCell) {
  using Real = TypeParam;
  Neighbours<Real> near;
  auto x = random_points<Real>(10000, Real(0.1), 3);
  for (const auto& p : random_points<Real>(3000, 30, 3)) x.push_back(p);
  near.sort(x, 1);
  Points<Real> sorted;
  for (const auto i : near.order()) sorted.push_back(x[usize(i)]);
  near.find(sorted, 1, Pairs::kHalf);
  EXPECT_GE(near.pair_count(), std::int64_t{10000} * 9999 / 2);
  near.find(sorted, 1, Pairs::kFull);
  EXPECT_GE(near.pair_count(), std::int64_t{10000} * 9999);
  const double entries = 4 * static_cast<double>(near.pair_count());
  EXPECT_LT(static_cast<double>(near.bytes()), 1.2 * entries);
}

// Clouds far apart, in all directions; with keys that do not fit 64 bits too.
TYPED_TEST(NeighboursOf, SparseAndUnbounded) {
  using Real = TypeParam;
  const Real far = std::ldexp(Real(1), std::numeric_limits<Real>::digits - 8);
  for (const int dimension : {2, 3}) {
    for (const Real distance : {Real(300), far}) {
      Points<Real> x;
      for (int corner = 0; corner < 8; ++corner) {
        auto cloud = random_points<Real>(60, 1, dimension);
        const Real unit = std::ldexp(Real(1), -6);  // what is exact far away
        for (auto& p : cloud) {
          p.x = std::round(p.x / unit) * unit + (corner & 1 ? distance : -distance);
          p.y = std::round(p.y / unit) * unit + (corner & 2 ? distance : -distance);
          if (dimension == 3) p.z = std::round(p.z / unit) * unit + (corner & 4 ? distance : 0);
        }
        x.insert(x.end(), cloud.begin(), cloud.end());
      }
      Neighbours<Real> near(dimension);
      EXPECT_GT(check<Real>(near, x, Real(0.3), Pairs::kHalf, 2), 1000);
      EXPECT_GT(check<Real>(near, x, Real(0.3), Pairs::kFull, 2), 2000);
    }
  }
}

// As far away as whole radii are exact, and over the border where their spacing doubles.
TYPED_TEST(NeighboursOf, AtTheEndOfTheNumbers) {
  using Real = TypeParam;
  for (const int bits :
       {std::numeric_limits<Real>::digits, std::numeric_limits<Real>::digits - 1}) {
    const Real end = std::ldexp(Real(1), bits);
    for (const Real radius : {Real(1), Real(1.5), Real(1.25)}) {
      Points<Real> x;
      Real coordinate = end * std::min(radius, Real(1));
      for (int k = 0; k < 40; ++k) coordinate = std::nextafter(coordinate, Real(0));
      for (int k = 0; k < 80 && coordinate <= end * radius; ++k) {
        x.push_back({coordinate, -coordinate, Real(k % 3), 0});
        x.push_back({coordinate, -coordinate, Real(k % 3) + Real(0.5), 0});
        coordinate = std::nextafter(coordinate, std::numeric_limits<Real>::infinity());
      }
      x.push_back({0, 0, 0, 0});
      x.push_back({end * radius, end * radius, end * radius, 0});
      x.push_back({-end * radius, -end * radius, -end * radius, 0});
      Neighbours<Real> near;
      EXPECT_GT(check<Real>(near, x, radius, Pairs::kFull), 40);
    }
  }
}

TYPED_TEST(NeighboursOf, RefusesWhatItCannotSort) {
  using Real = TypeParam;
  Neighbours<Real> near;
  const auto good = random_points<Real>(100, 1, 3);
  near.sort(good, Real(0.1));
  const std::vector before(near.order().begin(), near.order().end());
  const Real nan = std::numeric_limits<Real>::quiet_NaN();
  const Real infinity = std::numeric_limits<Real>::infinity();
  const Real beyond =
      std::nextafter(std::ldexp(Real(0.125), std::numeric_limits<Real>::digits), infinity);
  for (const Real bad : {nan, infinity, -infinity, beyond, -beyond}) {
    auto x = good;
    x[42].z = bad;
    x[77].x = bad;
    try {
      near.sort(x, Real(0.125));
      ADD_FAILURE() << bad;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find("points[42]"), std::string::npos) << error.what();
    }
  }
  for (const Real bad : {nan, infinity, Real(0), Real(-1), std::numeric_limits<Real>::min(),
                         std::numeric_limits<Real>::max()}) {
    EXPECT_THROW(near.sort(good, bad), InputError) << bad;
  }
  EXPECT_EQ(std::vector(near.order().begin(), near.order().end()), before);
  EXPECT_THROW(near.find(Points<Real>(99), Real(0.1)), InputError);
}

// Steps that move little need no more memory, and what a crowd needed is given back.
TYPED_TEST(NeighboursOf, MemoryFollowsTheLists) {
  using Real = TypeParam;
  Neighbours<Real> near;
  const auto search = [&](const Points<Real>& x, Real radius) {
    near.sort(x, radius);
    Points<Real> sorted;
    for (const auto i : near.order()) sorted.push_back(x[usize(i)]);
    near.find(sorted, radius);
    return near.bytes();
  };
  const auto x = random_points<Real>(5000, 1, 3);
  const std::size_t once = search(x, Real(0.11));
  EXPECT_GT(near.pair_count() / 5000, 20);
  std::int64_t padded = 0;
  for (int i = 0; i < 5000; ++i) padded += near[i].padded();
  EXPECT_LT(static_cast<double>(once), 1.15 * 4 * static_cast<double>(padded) + 100.0 * 5000);
  EXPECT_EQ(search(x, Real(0.11)), once);
  EXPECT_GT(search(x, Real(0.5)), 10 * once);
  EXPECT_LT(search(x, Real(0.11)), 2 * once);
}

}  // namespace
