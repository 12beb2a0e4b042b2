// What a kernel moves and computes, as counters beside its time: so that it can be read how far
// from the roofline (Williams, Waterman, Patterson, CACM 52(4), 2009) it runs.
//
// Bytes are those that a kernel has to move: each array that it reads or writes, once. Flops are
// additions, multiplications, divisions and roots of the formulas (an FMA is two), not counting
// comparisons, negations, and lanes that are padding. All are of one item: a step, a pair, a node.
#pragma once

#include <benchmark/benchmark.h>

namespace substep::bench {

struct Work {
  double items = 1;    // of an iteration
  double bytes = 0;    // of an item
  double flops = 0;    // of an item
  double set = 0;      // bytes that an iteration goes over: which cache they come from
  bool single = true;  // float32; else float64
};

inline void report(benchmark::State& state, const Work& work) {
  using benchmark::Counter;
  const auto rate = [&](double of_item) {
    return Counter(of_item * work.items, Counter::kIsIterationInvariantRate);
  };
  state.counters["items"] = work.items;
  state.counters["set"] = work.set;
  state.counters["single"] = work.single ? 1 : 0;
  state.counters["bytes/item"] = work.bytes;
  state.counters["flops/item"] = work.flops;
  state.counters["items/s"] = rate(1);
  state.counters["bytes/s"] = rate(work.bytes);
  state.counters["flops/s"] = rate(work.flops);
}

}  // namespace substep::bench
