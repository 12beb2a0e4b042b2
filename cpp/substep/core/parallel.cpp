#include "substep/core/parallel.h"

#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <cfenv>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <exception>
#include <limits>
#include <mutex>
#include <new>
#include <optional>
#include <thread>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/loop_stop.h"
#include "substep/core/usize.h"

namespace substep {
namespace {

constexpr auto kPollInterval = std::chrono::milliseconds(20);
constexpr int kSpins = 2000;  // about 20 us: what a sleeping thread would need to wake up

std::atomic<unsigned> forks{0};  // how often this process is a child of a fork()
[[gnu::tls_model("initial-exec")]] thread_local bool inside_task = false;

inline void pause_cpu() {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

template <class Condition>
void spin_until(const Condition& condition) {
  for (int i = 0; i < kSpins && !condition(); ++i) pause_cpu();
}

// One parallel call: shared by the caller and the workers that join it. Nobody waits for a thread
// that has not come; a phase ends when its chunks have run, whoever ran them.
class Job {
 public:
  using Task = std::function<void(std::int64_t, std::int64_t)>;

  Job(const Task& task, std::span<const std::int64_t> chunks, int threads)
      : threads_(threads),
        task_(task),
        chunks_(chunks),
        ranges_(chunks.size() * usize(threads)),
        done_(chunks.size()) {
    for (std::size_t phase = 0; phase < chunks.size(); ++phase) {
      for (int i = 0; i < threads; ++i) {
        range(phase, i).next = begin_of(chunks[phase], i);
        range(phase, i).end = begin_of(chunks[phase], i + 1);
      }
    }
    std::fegetenv(&floating_point_);
  }

  int threads() const { return threads_; }

  // The share of one thread: of each phase its own range, then what is left of the others'.
  void run(int thread) {
    inside_task = true;
    for (std::size_t phase = 0; phase < chunks_.size() && !stopped(); ++phase) {
      for (int k = 0; k < threads_; ++k)
        run_range(phase, range(phase, (thread + k) % threads_), thread == 0);
      if (phase + 1 < chunks_.size()) wait_for(phase, thread);
    }
    inside_task = false;
  }

  // A worker computes in the caller's rounding and denormal modes.
  void run_as_worker(int thread) {
    std::fenv_t own;
    std::fegetenv(&own);
    std::fesetenv(&floating_point_);
    run(thread);
    std::fesetenv(&own);
  }

  // Ctrl-C, on the calling thread: the first exception is kept and ends the job.
  void poll() {
    if (interrupt_) return;
    try {
      poll_interrupt();
    } catch (...) {
      interrupt_ = std::current_exception();
      stop_.store(true, std::memory_order_relaxed);
    }
  }

  void rethrow() const {
    if (interrupt_) std::rethrow_exception(interrupt_);
    if (error_) std::rethrow_exception(error_);
  }

 private:
  struct alignas(64) Range {
    std::atomic<std::int64_t> next{0};
    std::int64_t end = 0;
  };
  struct alignas(64) Counter {
    std::atomic<std::int64_t> value{0};
  };

  Range& range(std::size_t phase, int thread) {
    return ranges_[phase * usize(threads_) + usize(thread)];
  }
  std::int64_t begin_of(std::int64_t chunks, int thread) const {
    return chunks / threads_ * thread + std::min<std::int64_t>(thread, chunks % threads_);
  }
  bool stopped() const { return stop_.load(std::memory_order_relaxed); }

  void run_range(std::size_t phase, Range& range, bool polls) {
    for (;;) {
      if (range.next.load(std::memory_order_relaxed) >= range.end) return;
      const std::int64_t chunk = range.next.fetch_add(1, std::memory_order_relaxed);
      if (chunk >= range.end || stopped()) return;
      if (chunk < lowest_failed_.load(std::memory_order_relaxed)) run_chunk(phase, chunk);
      done_[phase].value.fetch_add(1, std::memory_order_acq_rel);
      if (polls) poll();
    }
  }

  void run_chunk(std::size_t phase, std::int64_t chunk) {
    try {
      const InLoop loop(stop_);
      task_(static_cast<std::int64_t>(phase), chunk);
    } catch (const LoopStopped&) {  // the exception that ended it is another thread's
    } catch (...) {
      const std::lock_guard lock(error_mutex_);
      if (chunk < lowest_failed_.load(std::memory_order_relaxed)) {
        lowest_failed_.store(chunk, std::memory_order_relaxed);
        error_ = std::current_exception();
      }
    }
  }

  // Until all chunks of the phase have run; no further phase follows one that failed.
  void wait_for(std::size_t phase, int thread) {
    const auto over = [&] {
      return done_[phase].value.load(std::memory_order_acquire) == chunks_[phase] || stopped();
    };
    for (spin_until(over); !over(); spin_until(over)) {
      if (thread == 0) poll();
      std::this_thread::yield();
    }
    if (lowest_failed_.load(std::memory_order_relaxed) != kNone) {
      stop_.store(true, std::memory_order_relaxed);
    }
  }

  static constexpr std::int64_t kNone = std::numeric_limits<std::int64_t>::max();

  const int threads_;
  const Task& task_;
  const std::span<const std::int64_t> chunks_;
  std::vector<Range> ranges_;
  std::vector<Counter> done_;
  std::fenv_t floating_point_;
  std::atomic<bool> stop_{false};
  std::atomic<std::int64_t> lowest_failed_{kNone};
  std::mutex error_mutex_;
  std::exception_ptr error_, interrupt_;
};

class Pool {
 public:
  // Serves one caller at a time, the holder of `busy`. Workers join while the job is open; the
  // caller does not wait for those that come late, only for those that have joined.
  void run(Job& job) {
    const unsigned forks_before = forks.load();
    {
      const std::lock_guard lock(mutex_);
      while (workers_ < job.threads() - 1 && start_worker()) ++workers_;
      job_ = &job;
      generation_.fetch_add(1, std::memory_order_release);
    }
    start_.notify_all();
    job.run(0);
    if (forks.load() != forks_before) {
      throw std::runtime_error("fork() inside a parallel loop: the child cannot go on with it");
    }
    spin_until([&] { return joined_.load(std::memory_order_relaxed) == 0; });
    std::unique_lock lock(mutex_);
    job_ = nullptr;
    while (joined_.load(std::memory_order_relaxed) != 0) {
      done_.wait_for(lock, kPollInterval);
      lock.unlock();
      job.poll();
      lock.lock();
    }
  }

  std::mutex busy;

 private:
  // Signals are for the threads of the application. False when no thread is to be had: then those
  // that there are share the work.
  bool start_worker() {
    sigset_t all, before;
    sigfillset(&all);
    for (const int fault : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT}) sigdelset(&all, fault);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    bool started = true;
    try {
      std::thread(&Pool::work, this, workers_, generation_.load()).detach();
    } catch (const std::exception&) {
      started = false;
    }
    pthread_sigmask(SIG_SETMASK, &before, nullptr);
    return started;
  }

  void work(int index, std::uint64_t seen) {
    for (;;) {
      const auto called = [&] { return generation_.load(std::memory_order_acquire) != seen; };
      spin_until(called);
      std::unique_lock lock(mutex_);
      start_.wait(lock, called);
      seen = generation_.load(std::memory_order_relaxed);
      Job* const job = job_;
      if (!job || index + 1 >= job->threads()) continue;
      joined_.fetch_add(1, std::memory_order_relaxed);
      lock.unlock();
      job->run_as_worker(index + 1);
      lock.lock();
      if (joined_.fetch_sub(1, std::memory_order_relaxed) == 1) done_.notify_one();
    }
  }

  std::mutex mutex_;  // guards all below; the atomics are also read by spinning threads
  std::condition_variable start_, done_;
  Job* job_ = nullptr;
  std::atomic<std::uint64_t> generation_{0};
  std::atomic<int> joined_{0};
  int workers_ = 0;
};

// Never destroyed: workers may still wait when the process ends. fork() copies only the calling
// thread, so the child drops the parent's pool and makes its own at its first parallel call.
std::atomic<Pool*> pool{nullptr};

[[maybe_unused]] const int registered = pthread_atfork(nullptr, nullptr, [] {
  pool = nullptr;
  inside_task = false;
  forks.fetch_add(1);
});

// None where there is no memory for one.
Pool* the_pool() {
  Pool* current = pool.load();
  if (current) return current;
  Pool* const fresh = new (std::nothrow) Pool;
  if (!fresh || pool.compare_exchange_strong(current, fresh)) return fresh;
  delete fresh;
  return current;
}

void run_serially(std::span<const std::int64_t> chunks, const Job::Task& task) {
  for (std::size_t phase = 0; phase < chunks.size(); ++phase) {
    for (std::int64_t chunk = 0; chunk < chunks[phase]; ++chunk) {
      task(static_cast<std::int64_t>(phase), chunk);
      poll_interrupt();
    }
  }
}

}  // namespace

void parallel_phases(std::span<const std::int64_t> chunks, const Job::Task& task, int threads) {
  std::int64_t widest = 0;
  for (const std::int64_t n : chunks) widest = std::max(widest, n);
  const std::int64_t wanted = std::min<std::int64_t>(threads > 0 ? threads : num_threads(), widest);
  if (wanted <= 1 || inside_task) return run_serially(chunks, task);
  Pool* const p = the_pool();
  if (p == nullptr) return run_serially(chunks, task);
  const std::unique_lock busy(p->busy, std::try_to_lock);
  if (!busy.owns_lock()) return run_serially(chunks, task);
  std::optional<Job> job;
  try {
    job.emplace(task, chunks, static_cast<int>(wanted));
  } catch (const std::bad_alloc&) {
    return run_serially(chunks, task);
  }
  p->run(*job);
  job->rethrow();
}

void parallel_chunks(std::int64_t chunks, const std::function<void(std::int64_t)>& task,
                     int threads) {
  parallel_phases(
      std::span(&chunks, 1), [&](std::int64_t, std::int64_t chunk) { task(chunk); }, threads);
}

}  // namespace substep
