// Projections of position-based dynamics by Gauss-Seidel, as a step does them: the constraints of
// each patch of particles, then those between patches, colour by colour. float32, rigid.
//
// A constraint is read: four bytes for each of its particles and its parameters. Of a particle 16
// bytes are read and written, once in a sweep: what joins particles of a patch finds them in the
// cache.
// Flops with m particles: C and its gradients, squares (5 m), their weighted sum (2 m), dlambda
// (2), and the particles moved (7 m). The gradient of a distance is d (3), d . d (5), its root (2),
// C (2) and n (3); that of the volume of a tetrahedron 9 differences, 3 + 3 products with 1/6,
// three cross products (9), their sum (6) and C (6).
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "substep/core/random.h"
#include "substep/core/usize.h"
#include "substep/pbd/groups/constraints.h"
#include "work.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::pbd;

// Particles on a lattice with a jitter, and constraints among them.
struct Mesh {
  std::vector<Point<float>> x;
  std::vector<std::int32_t> particles;
  std::vector<double> parameters;

  Mesh(int wide, int deep, int high) {
    std::uint64_t draw = 0;
    for (int i = 0; i < wide * deep * high; ++i) {
      const auto at = [&](int k) { return static_cast<float>(k + 0.2 * uniform2(1, draw++)[0]); };
      x.push_back({at(i % wide), at(i / wide % deep), at(i / wide / deep), 1});
    }
    x.push_back({0, 0, 0, 0});  // the empty row
  }
};

// A sheet with diagonals, three springs a particle.
Mesh cloth(int side) {
  Mesh mesh(side, side, 1);
  const auto join = [&](int i, int j, double rest) {
    mesh.particles.insert(mesh.particles.end(), {i, j});
    mesh.parameters.push_back(rest);
  };
  for (int i = 0; i < side * side; ++i) {
    const bool right = i % side + 1 < side, up = i / side + 1 < side;
    if (right) join(i, i + 1, 1);
    if (up) join(i, i + side, 1);
    if (right && up) join(i, i + side + 1, 1.41421356);
  }
  return mesh;
}

// A block of cubes, each cut into five tetrahedra (mirrored in every other one).
Mesh solid(int side) {
  Mesh mesh(side, side, side);
  static constexpr int kCorners[2][5][4] = {
      {{0, 3, 5, 6}, {1, 0, 5, 3}, {2, 3, 6, 0}, {4, 6, 5, 0}, {7, 5, 6, 3}},
      {{1, 4, 7, 2}, {0, 1, 2, 4}, {3, 2, 1, 7}, {5, 4, 1, 7}, {6, 4, 7, 2}}};
  const auto position = [&](int p) { return mesh.x[usize(p)]; };
  for (int c = 0; c < (side - 1) * (side - 1) * (side - 1); ++c) {
    const int n = side - 1, i = c % n, j = c / n % n, k = c / n / n;
    for (const auto& corners : kCorners[(i + j + k) % 2]) {
      int p[4];
      for (int a = 0; a < 4; ++a) {
        const int q = corners[a];
        p[a] = i + q % 2 + side * (j + q / 2 % 2 + side * (k + q / 4));
      }
      const auto o = position(p[0]);
      float d[3][3];
      for (int a = 0; a < 3; ++a) {
        const auto y = position(p[a + 1]);
        d[a][0] = y.x - o.x, d[a][1] = y.y - o.y, d[a][2] = y.z - o.z;
      }
      const float volume = (d[0][0] * (d[1][1] * d[2][2] - d[1][2] * d[2][1]) +
                            d[0][1] * (d[1][2] * d[2][0] - d[1][0] * d[2][2]) +
                            d[0][2] * (d[1][0] * d[2][1] - d[1][1] * d[2][0])) /
                           6;
      mesh.particles.insert(mesh.particles.end(), {p[0], p[1], p[2], p[3]});
      mesh.parameters.push_back(1.01 * static_cast<double>(volume));
    }
  }
  return mesh;
}

void sweep(benchmark::State& state, const std::string& kind, const Mesh& mesh, int points,
           double flops) {
  const auto n = static_cast<std::int64_t>(mesh.x.size()) - 1;
  const Partition partition = make_partition<float>(std::span(mesh.x.data(), usize(n)), 4096);
  std::vector<Point<float>> x(mesh.x);
  for (std::size_t slot = 0; slot < partition.id.size(); ++slot) {
    x[slot] = mesh.x[usize(partition.id[slot])];
  }
  const std::vector<Point<float>> start = x;
  Softness rigid;
  rigid.compliance = rigid.damping = {0.0};
  const auto group = make_group<float>(kind, mesh.particles, mesh.parameters, rigid);
  group->attach(partition);
  group->begin_step(1e-3, 10, 1);
  const Sweep<float> s{x.data(), start.data(), nullptr, n, 1e-3, 0, 10, 0, 1, 1.0};
  for (auto _ : state) {
    for (std::int64_t p = 0; p < partition.patches(); ++p) group->project_patch(p, s);
    for (int phase = 0; phase < group->phases(); ++phase) {
      for (std::int64_t c = 0; c < group->chunks(phase); ++c) group->project(phase, c, s);
    }
  }
  const auto count = static_cast<double>(group->size());
  const double bytes = 4 * points + 4 + 32.0 * static_cast<double>(n) / count;
  bench::report(state, {.items = count,
                        .bytes = bytes,
                        .flops = flops + 14 * points + 2,
                        .set = bytes * count - 16.0 * static_cast<double>(n)});
}

void distances(benchmark::State& state) {
  sweep(state, "distance", cloth(static_cast<int>(state.range(0))), 2, 3 + 5 + 2 + 2 + 3);
}
void volumes(benchmark::State& state) {
  sweep(state, "tetrahedron_volume", solid(static_cast<int>(state.range(0))), 4,
        9 + 6 + 27 + 6 + 6);
}

BENCHMARK(distances)->Name("pbd/distance")->Arg(256)->Unit(benchmark::kMicrosecond);
BENCHMARK(volumes)->Name("pbd/tetrahedron_volume")->Arg(40)->Unit(benchmark::kMicrosecond);

}  // namespace
