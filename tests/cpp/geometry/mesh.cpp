#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "substep/core/usize.h"
#include "substep/geometry/isosurface_stuffing.h"
#include "substep/geometry/mesh_sampling.h"

namespace {

using substep::usize;

using namespace substep::geometry;

// The cube [-1, 1]^3, looking outward.
const std::vector<double> kCorners = {-1, -1, -1, 1, -1, -1, 1, 1, -1, -1, 1, -1,
                                      -1, -1, 1,  1, -1, 1,  1, 1, 1,  -1, 1, 1};
const std::vector<std::int64_t> kFaces = {0, 2, 1, 0, 3, 2, 4, 5, 6, 4, 6, 7, 0, 1, 5, 0, 5, 4,
                                          1, 2, 6, 1, 6, 5, 2, 3, 7, 2, 7, 6, 3, 0, 4, 3, 4, 7};

TriangleTree cube() { return {kCorners.data(), kFaces.data(), 12}; }

TEST(TriangleTree, KnowsTheCube) {
  const TriangleTree tree = cube();
  EXPECT_TRUE(tree.closed());
  EXPECT_DOUBLE_EQ(tree.signed_distance({0, 0, 0.25}), -0.75);
  EXPECT_DOUBLE_EQ(tree.signed_distance({4, 5, 1}), 5);
  EXPECT_EQ(tree.signed_distance({1, 0.5, 0.25}), 0);
  EXPECT_NEAR(tree.winding_number({0.1, 0.2, 0.3}), 1, 1e-12);
}

TEST(TriangleTree, SearchesWithinABound) {
  const TriangleTree tree = cube();
  EXPECT_EQ(tree.nearest({3, 0, 0}, 1.999).face, -1);
  EXPECT_EQ(tree.nearest({3, 0, 0}, 2).distance, 2);  // the bound is included
  EXPECT_EQ(tree.nearest({1, 0, 0}, 0).distance, 0);
}

TEST(TriangleTree, TakesFlatAndCoincidentTriangles) {
  const std::vector<double> points = {0, 0, 0, 1, 0, 0, 2, 0, 0};
  std::vector<std::int64_t> faces;
  for (int i = 0; i < 1000; ++i) faces.insert(faces.end(), {0, 1, 2});
  faces.insert(faces.end(), {1, 1, 1});
  const TriangleTree tree(points.data(), faces.data(), 1001);
  EXPECT_DOUBLE_EQ(tree.nearest({1.5, 3, 4}).distance, 5);
  EXPECT_EQ(tree.winding_number({1.5, 3, 4}), 0);
  EXPECT_FALSE(tree.inside({1.5, 3, 4}));
}

TEST(IsosurfaceStuffing, FillsACubeWithoutGapsOrOverlaps) {
  const Tetrahedra solid = stuff_isosurface(cube(), 0.3, 2);
  std::map<std::array<std::int64_t, 3>, int> uses;
  double volume = 0;
  for (const auto& cell : solid.cells) {
    const auto x = [&](std::size_t i) { return solid.vertices[usize(cell[i])]; };
    const double part = (x(1) - x(0)).cross(x(2) - x(0)).dot(x(3) - x(0)) / 6;
    EXPECT_GT(part, 1e-3 * 0.3 * 0.3 * 0.3);
    volume += part;
    for (std::size_t side = 0; side < 4; ++side) {
      std::array<std::int64_t, 3> face{};
      for (std::size_t i = 0, n = 0; i < 4; ++i)
        if (i != side) face[n++] = cell[i];
      std::sort(face.begin(), face.end());
      ++uses[face];
    }
  }
  std::map<std::pair<std::int64_t, std::int64_t>, int> border;
  for (const auto& [face, count] : uses) {
    EXPECT_LE(count, 2);
    if (count == 2) continue;
    for (const auto& [i, j] : {std::pair(0, 1), std::pair(0, 2), std::pair(1, 2)})
      ++border[{face[usize(i)], face[usize(j)]}];
  }
  for (const auto& [edge, count] : border) EXPECT_EQ(count % 2, 0);
  EXPECT_NEAR(volume, 8, 0.25);  // edges and corners are rounded
  for (const Vec3& x : solid.vertices) EXPECT_LT(cube().signed_distance(x), 1e-3);
}

TEST(SampleSignedDistance, IsThatOfEveryNode) {
  const TriangleTree tree = cube();
  std::vector<double> values(9 * 8 * 7);
  sample_signed_distance(tree, {9, 8, 7}, {-2, -1.75, -1.5}, 0.5, values.data(), 2);
  std::size_t n = 0;
  for (int i = 0; i < 9; ++i)
    for (int j = 0; j < 8; ++j)
      for (int k = 0; k < 7; ++k)
        EXPECT_DOUBLE_EQ(values[n++],
                         tree.signed_distance({-2 + 0.5 * i, -1.75 + 0.5 * j, -1.5 + 0.5 * k}));
}

}  // namespace
