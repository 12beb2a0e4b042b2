#include "substep/linalg/direct/ordering.h"

#include <mutex>
#include <numeric>

#include "substep/core/usize.h"
#include "substep/linalg/direct/cholmod_common.h"
#include "substep/linalg/direct/library_calls.h"

namespace substep {
namespace {

// The graph of the vertices: vertex i and j are neighbours when any of their unknowns are.
SparsePattern vertex_graph(const SparsePattern& lower, std::int32_t block) {
  const std::int32_t vertices = lower.cols / block;
  SparsePattern graph{vertices, vertices, {0}, {}};
  std::vector<std::int32_t> seen(usize(vertices), -1);
  for (std::int32_t v = 0; v < vertices; ++v) {
    for (auto k = lower.start[usize(v * block)]; k < lower.start[usize((v + 1) * block)]; ++k) {
      const std::int32_t u = lower.row[usize(k)] / block;
      if (seen[usize(u)] != v) {
        seen[usize(u)] = v;
        graph.row.push_back(u);
      }
    }
    graph.start.push_back(static_cast<std::int32_t>(graph.row.size()));
  }
  return graph;
}

}  // namespace

std::vector<std::int32_t> elimination_order(const SparsePattern& lower, Ordering ordering,
                                            std::int32_t block) {
  const SparsePattern vertices = block > 1 ? vertex_graph(lower, block) : SparsePattern{};
  const SparsePattern& graph = block > 1 ? vertices : lower;
  std::vector<std::int32_t> order(usize(graph.cols));
  std::iota(order.begin(), order.end(), 0);
  if (ordering != Ordering::natural && graph.cols > 1) {
    const LibraryCalls guard;
    CholmodCommon common;
    common.metis_memory = 2;  // METIS ends the process where it finds no memory: asked before
    cholmod_sparse a = cholmod_lower(graph, nullptr);
    a.sorted = 0;
    if (ordering == Ordering::metis) {
      // It catches SIGABRT and SIGTERM while it runs, for the process: one at a time.
      static std::mutex one_at_a_time;
      const std::scoped_lock lock(one_at_a_time);
      cholmod_metis(&a, nullptr, 0, 1, order.data(), &common);
    } else {
      cholmod_amd(&a, nullptr, 0, order.data(), &common);
    }
    common.throw_if_out_of_memory();
  }
  if (block == 1) return order;
  std::vector<std::int32_t> expanded;
  expanded.reserve(order.size() * usize(block));
  for (const std::int32_t v : order) {
    for (std::int32_t c = 0; c < block; ++c) expanded.push_back(v * block + c);
  }
  return expanded;
}

}  // namespace substep

// METIS draws its random numbers from rand() of the C library and seeds it: the state of the whole
// process, so that the order of elimination, and with it the bits of a factor, would depend on who
// else draws. These three functions are all that METIS (GKlib) takes them from; the loader prefers
// our definitions to those of the library (see blas_buffers.h), and each thread has its own
// numbers.
namespace {

thread_local std::uint64_t state = 0;

// SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014).
std::uint64_t next() {
  std::uint64_t z = (state += 0x9E3779B97F4A7C15u);
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}

}  // namespace

extern "C" {
__attribute__((visibility("default"))) void gk_randinit(std::uint64_t seed) { state = seed; }
__attribute__((visibility("default"))) std::uint32_t gk_randint32() {
  return static_cast<std::uint32_t>(next() >> 33);  // 31 bits, as rand() has them
}
__attribute__((visibility("default"))) std::uint64_t gk_randint64() { return next() >> 1; }
}
