// Our own small thread pool. Work is cut into chunks whose bounds never depend on the number of
// threads, and whoever sums does so over the chunks in order: so results are the same bits for any
// number of threads. A call from inside a task, or while another thread is using the pool, runs
// serially, with the same bits. After fork() the child starts a pool of its own.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

namespace substep {

// The default for calls that pass threads = 0: SUBSTEP_NUM_THREADS, else the cores that this
// process may use (affinity and cgroup quota). Throws InputError if the variable is not a number.
int num_threads();
void set_num_threads(int threads);

// Calls task(chunk) for each chunk in [0, chunks) once, on up to `threads` threads (0: default).
// Thread i starts on the i-th contiguous range of chunks, so that repeated loops find their data in
// its cache, and helps out in the other ranges when its own is done. The calling thread takes part
// and polls for Ctrl-C between its chunks and while it waits for the others: keep chunks short.
// If tasks throw, all chunks below the lowest failed one have run and its exception is thrown.
// Where there is no memory for sharing the work, the calling thread does it alone.
void parallel_chunks(std::int64_t chunks, const std::function<void(std::int64_t)>& task,
                     int threads = 0);

// Several such loops one after the other, for less than they cost one by one: task(phase, chunk)
// for each chunk in [0, chunks[phase]); a phase begins when all of the one before has run. If tasks
// throw, the exception is that of the lowest failed chunk of the first phase with one, and later
// phases do not run.
void parallel_phases(std::span<const std::int64_t> chunks,
                     const std::function<void(std::int64_t, std::int64_t)>& task, int threads = 0);

// The same over [0, n) in chunks of `grain` items: task(begin, end).
template <class Task>
void parallel_for(std::int64_t n, std::int64_t grain, Task&& task, int threads = 0) {
  const auto run = [&](std::int64_t chunk) {
    const std::int64_t begin = chunk * grain;
    task(begin, n - begin > grain ? begin + grain : n);
  };
  // By reference: a std::function holds that without memory, so that loops never want for it.
  parallel_chunks(n > 0 ? (n - 1) / grain + 1 : 0, std::cref(run), threads);
}

}  // namespace substep
