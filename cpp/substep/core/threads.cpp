// How many threads the loops of parallel.h use by default.
#include <sched.h>

#include <algorithm>
#include <atomic>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <string>
#include <string_view>
#include <thread>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"

namespace substep {
namespace {

constexpr int kMaxThreads = 1024;
std::atomic<int> configured{0};

// Cores by the control group's quota ("max" or microseconds, then the period), as containers set
// it.
int quota_cores() {
  std::ifstream file("/sys/fs/cgroup/cpu.max");
  double quota = 0, period = 0;
  if (file >> quota >> period && quota > 0 && period > 0) {
    return std::max(1, static_cast<int>(std::lround(std::ceil(quota / period))));
  }
  return kMaxThreads;
}

int available_cores() {
  cpu_set_t set;
  const int cores = sched_getaffinity(0, sizeof set, &set) == 0
                        ? CPU_COUNT(&set)
                        : static_cast<int>(std::thread::hardware_concurrency());
  return std::clamp(std::min(cores, quota_cores()), 1, kMaxThreads);
}

int default_threads() {
  const char* const text = std::getenv("SUBSTEP_NUM_THREADS");
  if (!text || !*text) return available_cores();
  const std::string_view view(text);
  int n = 0;
  const auto [end, error] = std::from_chars(view.data(), view.data() + view.size(), n);
  if (error != std::errc{} || end != view.data() + view.size() || n < 1 || n > kMaxThreads) {
    throw InputError("SUBSTEP_NUM_THREADS: expected an integer from 1 to " +
                     std::to_string(kMaxThreads) + ", got " + text);
  }
  return n;
}

}  // namespace

int num_threads() {
  int n = configured.load();
  if (n == 0) {
    n = default_threads();
    int expected = 0;
    if (!configured.compare_exchange_strong(expected, n)) n = expected;
  }
  return n;
}

void set_num_threads(int threads) {
  if (threads < 1 || threads > kMaxThreads) {
    throw InputError("threads: expected an integer from 1 to " + std::to_string(kMaxThreads) +
                     ", got " + std::to_string(threads));
  }
  configured = threads;
}

}  // namespace substep
