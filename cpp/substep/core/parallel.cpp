#include "substep/core/parallel.h"

#include <pthread.h>
#include <sched.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"

namespace substep {
namespace {

constexpr int kMaxThreads = 1024;

int default_threads() {
  if (const char* text = std::getenv("SUBSTEP_NUM_THREADS")) {
    const int n = std::atoi(text);
    if (n >= 1 && n <= kMaxThreads) return n;
  }
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof set, &set) == 0) return std::max(1, CPU_COUNT(&set));
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

std::atomic<int> configured{0};
thread_local bool inside_task = false;

// One parallel call: shared by the caller and the workers, which take the static ranges.
struct Job {
  const std::function<void(std::int64_t)>* task = nullptr;
  std::int64_t chunks = 0;
  int threads = 0;
  std::atomic<bool> stop{false};
  std::vector<std::exception_ptr> errors;

  void run(int thread) {
    const std::int64_t begin = chunks * thread / threads;
    const std::int64_t end = chunks * (thread + 1) / threads;
    inside_task = true;
    try {
      for (std::int64_t chunk = begin; chunk < end; ++chunk) {
        if (stop.load(std::memory_order_relaxed)) break;
        (*task)(chunk);
        if (thread == 0) poll_interrupt();
      }
    } catch (...) {
      errors[static_cast<std::size_t>(thread)] = std::current_exception();
      stop = true;
    }
    inside_task = false;
  }
};

class Pool {
 public:
  void run(Job& job) {
    std::unique_lock lock(mutex_);
    while (static_cast<int>(workers_) < job.threads - 1) {
      try {
        std::thread(&Pool::work, this, workers_, generation_).detach();
      } catch (const std::system_error&) {  // no more threads to be had: share what there is
        job.threads = workers_ + 1;
        break;
      }
      ++workers_;
    }
    job_ = &job;
    pending_ = job.threads - 1;
    ++generation_;
    lock.unlock();
    start_.notify_all();
    job.run(0);
    lock.lock();
    done_.wait(lock, [&] { return pending_ == 0; });
    job_ = nullptr;
  }

  std::mutex busy;  // held by the one caller that the pool serves

 private:
  void work(int index, std::uint64_t seen) {
    std::unique_lock lock(mutex_);
    for (;;) {
      start_.wait(lock, [&] { return generation_ != seen; });
      seen = generation_;
      Job* job = job_;
      if (!job || index + 1 >= job->threads) continue;
      lock.unlock();
      job->run(index + 1);
      lock.lock();
      if (--pending_ == 0) done_.notify_one();
    }
  }

  std::mutex mutex_;
  std::condition_variable start_, done_;
  Job* job_ = nullptr;
  std::uint64_t generation_ = 0;
  int workers_ = 0, pending_ = 0;
};

// Never destroyed: workers may still wait when the process ends. fork() copies only the calling
// thread, so the child drops the parent's pool and makes its own at its first parallel call.
std::atomic<Pool*> pool{nullptr};

Pool& the_pool() {
  static const int once = pthread_atfork(nullptr, nullptr, [] {
    pool = nullptr;
    inside_task = false;
  });
  static_cast<void>(once);
  Pool* current = pool.load();
  if (!current) {
    Pool* fresh = new Pool;
    if (pool.compare_exchange_strong(current, fresh)) return *fresh;
    delete fresh;
  }
  return *current;
}

void run_serially(std::int64_t chunks, const std::function<void(std::int64_t)>& task) {
  for (std::int64_t chunk = 0; chunk < chunks; ++chunk) {
    task(chunk);
    poll_interrupt();
  }
}

}  // namespace

int num_threads() {
  int n = configured.load();
  if (n == 0) {
    n = default_threads();
    configured = n;
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

void parallel_chunks(std::int64_t chunks, const std::function<void(std::int64_t)>& task,
                     int threads) {
  const std::int64_t wanted = std::min<std::int64_t>(threads > 0 ? threads : num_threads(), chunks);
  if (wanted <= 1 || inside_task) return run_serially(chunks, task);
  Pool& p = the_pool();
  const std::unique_lock busy(p.busy, std::try_to_lock);
  if (!busy.owns_lock()) return run_serially(chunks, task);

  Job job;
  job.task = &task;
  job.chunks = chunks;
  job.threads = static_cast<int>(wanted);
  job.errors.resize(static_cast<std::size_t>(wanted));
  p.run(job);
  for (const std::exception_ptr& error : job.errors) {
    if (error) std::rethrow_exception(error);
  }
}

}  // namespace substep
