#include "substep/geometry/mesh_sampling.h"

#include <cmath>
#include <vector>

#include "substep/core/parallel.h"

namespace substep::geometry {

namespace {

struct Grid {
  std::array<std::int64_t, 3> shape;
  Vec3 origin;
  double spacing;

  Vec3 position(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return origin +
           spacing * Vec3(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k));
  }
};

// The nearest point of the neighbour bounds the search. Where the neighbour is further than the
// spacing from a closed surface, it lies on the same side.
void sample_mesh(const TriangleTree& tree, const Grid& grid, double* distance, int threads) {
  const auto [nx, ny, nz] = grid.shape;
  const auto plane = [&](std::int64_t i) {
    Vec3 row_start = Vec3::Zero(), last = row_start;  // nearest points
    for (std::int64_t j = 0; j < ny; ++j) {
      double* row = distance + (i * ny + j) * nz;
      last = row_start;
      for (std::int64_t k = 0; k < nz; ++k) {
        const Vec3 x = grid.position(i, j, k);
        TriangleTree::Nearest near;
        if (j > 0 || k > 0) near = tree.nearest(x, (x - last).norm() * (1 + 1e-12));
        if (near.face < 0) near = tree.nearest(x);
        last = near.point;
        if (k == 0) row_start = near.point;
        if (k > 0 && tree.closed() && std::abs(row[k - 1]) > (1 + 1e-9) * grid.spacing) {
          row[k] = std::copysign(near.distance, row[k - 1]);
        } else {
          row[k] = tree.inside(x) ? -near.distance : near.distance;
        }
      }
    }
  };
  parallel_chunks(nx, plane, threads);
}

// Across a hole the sign changes where there is no surface: there the solid ends where w = 1/2.
// The points of that cap on the edges of the grid are those where two nodes of different sign are
// further from the mesh, both together, than from each other.
std::vector<double> find_caps(const TriangleTree& tree, const Grid& grid, const double* distance) {
  const auto [nx, ny, nz] = grid.shape;
  std::vector<double> points;
  const auto look = [&](const Vec3& a, const Vec3& b, double da, double db) {
    if ((da < 0) == (db < 0) || std::abs(da) + std::abs(db) <= (1 + 1e-9) * grid.spacing) return;
    const double wa = std::abs(std::abs(tree.winding_number(a)) - 0.5);
    const double wb = std::abs(std::abs(tree.winding_number(b)) - 0.5);
    const Vec3 cap = wa + wb > 0 ? Vec3(a + wa / (wa + wb) * (b - a)) : a;
    points.insert(points.end(), {cap[0], cap[1], cap[2]});
  };
  for (std::int64_t i = 0; i < nx; ++i) {
    for (std::int64_t j = 0; j < ny; ++j) {
      for (std::int64_t k = 0; k < nz; ++k) {
        const double* here = distance + (i * ny + j) * nz + k;
        const Vec3 x = grid.position(i, j, k);
        if (i + 1 < nx) look(x, grid.position(i + 1, j, k), *here, here[ny * nz]);
        if (j + 1 < ny) look(x, grid.position(i, j + 1, k), *here, here[nz]);
        if (k + 1 < nz) look(x, grid.position(i, j, k + 1), *here, here[1]);
      }
    }
  }
  return points;
}

// The distance to the nearest cap where that is nearer than the mesh.
void add_caps(const std::vector<double>& points, const Grid& grid, double* distance, int threads) {
  const auto count = static_cast<std::int64_t>(points.size() / 3);
  std::vector<std::int64_t> faces;  // each point as a triangle
  for (std::int64_t i = 0; i < count; ++i) faces.insert(faces.end(), {i, i, i});
  const TriangleTree caps(points.data(), faces.data(), count);
  const auto plane = [&](std::int64_t i) {
    double* value = distance + i * grid.shape[1] * grid.shape[2];
    for (std::int64_t j = 0; j < grid.shape[1]; ++j) {
      for (std::int64_t k = 0; k < grid.shape[2]; ++k, ++value) {
        const auto near = caps.nearest(grid.position(i, j, k), std::abs(*value));
        if (near.face >= 0) *value = std::copysign(near.distance, *value);
      }
    }
  };
  parallel_chunks(grid.shape[0], plane, threads);
}

}  // namespace

void sample_signed_distance(const TriangleTree& tree, const std::array<std::int64_t, 3>& shape,
                            const Vec3& origin, double spacing, double* distance, int threads) {
  const Grid grid{shape, origin, spacing};
  sample_mesh(tree, grid, distance, threads);
  if (tree.closed()) return;
  const std::vector<double> caps = find_caps(tree, grid, distance);
  if (!caps.empty()) add_caps(caps, grid, distance, threads);
}

}  // namespace substep::geometry
