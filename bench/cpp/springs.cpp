// Assembly of springs: energy, gradient, and gradient with Hessian, of a square cloth with
// diagonals (four springs a vertex).
//
// A spring writes its gradient (24 bytes) and its block of the Hessian (72) into arrays, from which
// vertices and blocks of the matrix gather them: so both are moved twice, as are the lists that say
// from where (8 bytes for each of 2 and 3 places). It reads its ends and constants (24) and fills a
// block of the matrix (72); its share of a vertex are position, gradient, mass and block of the
// diagonal: (24 + 24 + 8 + 48) / 4.
// Flops of a spring (spring_term.cpp): x_i - x_j 3, its length 6, u 4, gradient 5; block of the
// Hessian 18; gathered 2 * 3, and 2 * 9.
#include <memory>
#include <vector>

#include "substep/springs/incremental_potential.h"
#include "substep/springs/spring_term.h"
#include "work.h"

namespace {

using namespace substep;
using namespace substep::springs;

class Cloth {
 public:
  explicit Cloth(int side) {
    auto springs = std::make_shared<Springs>();
    const auto join = [&](int i, int j) {
      springs->vertices.insert(springs->vertices.end(), {i, j});
      springs->stiffness.push_back(100);
      springs->rest_lengths.push_back(0.9 * (x[std::size_t(i)] - x[std::size_t(j)]).norm());
    };
    for (int i = 0; i < side * side; ++i) x.push_back({0.01 * (i % side), 0.01 * (i / side), 1});
    for (int i = 0; i < side * side; ++i) {
      const bool right = i % side + 1 < side, up = i / side + 1 < side;
      if (right) join(i, i + 1);
      if (up) join(i, i + side);
      if (right && up) join(i, i + side + 1), join(i + 1, i + side);
    }
    count = static_cast<double>(springs->stiffness.size());
    potential = std::make_unique<IncrementalPotential>(
        std::vector<double>(x.size(), 0.01), std::vector<std::uint8_t>(x.size(), 0),
        std::vector<std::shared_ptr<Term>>{std::make_shared<SpringTerm>(springs)}, 1);
    potential->begin_step(x, x, 0.01);
    gradient.resize(x.size());
    values.resize(potential->pattern().rows.size());
  }

  std::vector<Vec3> x, gradient;
  std::vector<double> values;
  double count = 0;  // of springs
  std::unique_ptr<IncrementalPotential> potential;
};

constexpr double kRead = 24, kOfVertex = (24 + 24 + 8) / 4;

void energy(benchmark::State& state) {
  Cloth cloth(static_cast<int>(state.range(0)));
  for (auto _ : state) benchmark::DoNotOptimize(cloth.potential->energy(cloth.x));
  const double bytes = kRead + (24 + 24 + 8) / 4;
  bench::report(state, {.items = cloth.count,
                        .bytes = bytes,
                        .flops = 3 + 6 + 4,
                        .set = bytes * cloth.count,
                        .single = false});
}
void gradient(benchmark::State& state) {
  Cloth cloth(static_cast<int>(state.range(0)));
  for (auto _ : state) cloth.potential->gradient(cloth.x, cloth.gradient);
  const double bytes = kRead + 2 * 24 + 2 * 8 + kOfVertex;
  bench::report(state, {.items = cloth.count,
                        .bytes = bytes,
                        .flops = 18 + 6,
                        .set = bytes * cloth.count,
                        .single = false});
}
void assemble(benchmark::State& state) {
  Cloth cloth(static_cast<int>(state.range(0)));
  for (auto _ : state) cloth.potential->assemble(cloth.x, 1.0, cloth.gradient, cloth.values);
  const double bytes = kRead + 2 * 24 + 2 * 72 + 5 * 8 + 72 + kOfVertex + 48.0 / 4;
  bench::report(state, {.items = cloth.count,
                        .bytes = bytes,
                        .flops = 18 + 18 + 6 + 18,
                        .set = bytes * cloth.count,
                        .single = false});
}

void sizes(benchmark::internal::Benchmark* b) { b->Arg(200)->Unit(benchmark::kMillisecond); }

BENCHMARK(energy)->Name("springs/energy")->Apply(sizes);
BENCHMARK(gradient)->Name("springs/gradient")->Apply(sizes);
BENCHMARK(assemble)->Name("springs/gradient_and_hessian")->Apply(sizes);

}  // namespace
