#include "substep/core/point_lanes.h"

#include <gtest/gtest.h>

#include <vector>

namespace substep {
namespace {

template <class V>
void check() {
  using Real = Lane<V>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  std::vector<Point<Real>> points(40);
  for (int i = 0; i < 40; ++i) {
    const Real a = static_cast<Real>(i);
    points[i] = {a, 100 + a, 200 + a, 300 + a};
  }
  std::vector<std::int32_t> index(kLanes);
  for (int k = 0; k < kLanes; ++k) index[k] = (7 * k + 3) % 40;
  const PointLanes<V> got = load_points<V>(points.data(), index.data());
  Real total = 0;
  for (int k = 0; k < kLanes; ++k) {
    EXPECT_EQ(got.x[k], index[k]);
    EXPECT_EQ(got.y[k], 100 + index[k]);
    EXPECT_EQ(got.z[k], 200 + index[k]);
    EXPECT_EQ(got.w[k], 300 + index[k]);
    total += got.x[k];
  }
  EXPECT_EQ(sum_lanes<V>(got.x), total);
  Point<Real> sums{};
  store_quad(sums, sum_points<V>(got));
  EXPECT_EQ(sums.x, total);
  EXPECT_EQ(sums.y, total + 100 * kLanes);
  EXPECT_EQ(sums.z, total + 200 * kLanes);
  EXPECT_EQ(sums.w, total + 300 * kLanes);
  const V inverse = inverse_sqrt<V>(got.y);
  for (int k = 0; k < kLanes; ++k) {
    const double want = 1 / std::sqrt(static_cast<double>(got.y[k]));
    EXPECT_NEAR(inverse[k] / want, 1, sizeof(Real) == 4 ? 4e-7 : 1e-15);
  }
}

TEST(PointLanes, GatheredSummedAndInverted) {
  check<Vector<float>>();
  check<Vector<double>>();
  check<Vector<float, 16>>();
  check<Vector<double, 16>>();
}

}  // namespace
}  // namespace substep
