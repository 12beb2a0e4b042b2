#include "substep/core/parallel.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cfenv>
#include <chrono>
#include <cstdlib>
#include <functional>
#include <numeric>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using substep::parallel_chunks;
using substep::parallel_for;

// Each chunk must run once; the counts are plain integers so that a race shows under TSan.
void expect_each_chunk_once(std::int64_t chunks, int threads) {
  std::vector<int> count(usize(chunks));
  parallel_chunks(chunks, [&](std::int64_t chunk) { ++count[usize(chunk)]; }, threads);
  for (const int c : count) ASSERT_EQ(c, 1);
}

TEST(Parallel, EveryChunkOnce) {
  for (const int threads : {0, 1, 2, 3, 4, 16}) {
    for (const std::int64_t chunks : {0, 1, 2, 3, 5, 64, 1001}) {
      expect_each_chunk_once(chunks, threads);
    }
  }
}

TEST(Parallel, BoundsDoNotDependOnThreads) {
  const auto bounds = [](int threads) {
    std::vector<std::pair<std::int64_t, std::int64_t>> found(11);
    parallel_for(
        1003, 100,
        [&](std::int64_t begin, std::int64_t end) { found[usize(begin / 100)] = {begin, end}; },
        threads);
    return found;
  };
  const auto serial = bounds(1);
  EXPECT_EQ(serial.back(), (std::pair<std::int64_t, std::int64_t>{1000, 1003}));
  for (const int threads : {2, 3, 4}) EXPECT_EQ(bounds(threads), serial);
}

TEST(Parallel, RangesAtTheEndOfInt64) {
  const std::int64_t n = std::numeric_limits<std::int64_t>::max();
  std::atomic<int> calls{0};
  parallel_for(
      n, n / 2, [&](std::int64_t begin, std::int64_t end) { calls += begin < end ? 1 : 100; }, 2);
  EXPECT_EQ(calls, 3);
  parallel_for(0, 10, [&](std::int64_t, std::int64_t) { ++calls; }, 2);
  EXPECT_EQ(calls, 3);
}

TEST(Parallel, ManySmallLoopsFromManyThreads) {
  std::vector<std::thread> callers;
  std::atomic<std::int64_t> total{0};
  for (int caller = 0; caller < 4; ++caller) {
    callers.emplace_back([&total, caller] {
      for (int repeat = 0; repeat < 2000; ++repeat) {
        std::vector<std::int64_t> part(7);
        parallel_chunks(
            7, [&](std::int64_t chunk) { part[usize(chunk)] = chunk; }, 1 + (caller + repeat) % 4);
        total += std::accumulate(part.begin(), part.end(), std::int64_t{0});
      }
    });
  }
  for (std::thread& caller : callers) caller.join();
  EXPECT_EQ(total, 4 * 2000 * 21);
}

TEST(Parallel, NestedLoopsRunSerially) {
  std::vector<int> count(64);
  parallel_chunks(
      8,
      [&](std::int64_t outer) {
        parallel_chunks(8, [&](std::int64_t inner) { ++count[usize(8 * outer + inner)]; }, 4);
      },
      4);
  for (const int c : count) EXPECT_EQ(c, 1);
}

TEST(Parallel, TheLowestFailedChunkThrows) {
  for (int repeat = 0; repeat < 200; ++repeat) {
    for (const int threads : {1, 2, 4}) {
      try {
        parallel_chunks(
            100,
            [](std::int64_t chunk) {
              if (chunk >= 17 && chunk % 5 == 2) throw std::runtime_error(std::to_string(chunk));
            },
            threads);
        FAIL() << "nothing thrown";
      } catch (const std::runtime_error& error) {
        ASSERT_STREQ(error.what(), "17");
      }
    }
  }
  expect_each_chunk_once(100, 4);
}

TEST(Parallel, WorkersUseTheCallersRounding) {
  std::vector<int> modes(64);
  std::fesetround(FE_UPWARD);
  parallel_chunks(
      64,
      [&](std::int64_t chunk) {
        modes[usize(chunk)] = std::fegetround();
        std::this_thread::sleep_for(std::chrono::microseconds(50));
      },
      4);
  std::fesetround(FE_TONEAREST);
  for (const int mode : modes) EXPECT_EQ(mode, FE_UPWARD);
}

// A loop of these chunks, on the thread that polls for Ctrl-C and on others.
void expect_interruptible(std::int64_t chunks, const std::function<void(std::int64_t)>& task) {
  static std::atomic<bool> asked{false};
  static const std::thread::id caller = std::this_thread::get_id();
  substep::set_interrupt_hook([] {
    if (asked && std::this_thread::get_id() == caller) throw std::runtime_error("interrupted");
  });
  for (const int threads : {1, 2, 4}) {
    asked = false;
    std::chrono::steady_clock::time_point when;
    std::thread user([&when] {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
      when = std::chrono::steady_clock::now();
      asked = true;
    });
    EXPECT_THROW(parallel_chunks(chunks, task, threads), std::runtime_error);
    user.join();
    EXPECT_LT(std::chrono::steady_clock::now() - when, std::chrono::milliseconds(100));
  }
  substep::set_interrupt_hook(nullptr);
  expect_each_chunk_once(100, 4);
}

TEST(Parallel, InterruptEndsTheLoopWithinATenthOfASecond) {
  const auto sleep = [] { std::this_thread::sleep_for(std::chrono::microseconds(100)); };
  expect_interruptible(1'000'000, [&](std::int64_t) { sleep(); });
  // Chunks of a second that poll, one on each thread; then one that the caller only waits for.
  const auto poll_for_a_second = [&] {
    for (int k = 0; k < 10'000; ++k) sleep(), substep::poll_interrupt();
  };
  expect_interruptible(4, [&](std::int64_t) { poll_for_a_second(); });
  expect_interruptible(4, [&](std::int64_t chunk) {
    if (chunk > 0) poll_for_a_second();
  });
}

#if !defined(__SANITIZE_THREAD__)  // TSan cannot start threads in the child of a threaded process
// Exit status of a child that runs `body`, or -1 if it has not ended after 10 s.
template <class Body>
int run_in_child(Body body) {
  const pid_t child = fork();
  if (child == 0) _exit(body());
  for (int wait = 0; wait < 1000; ++wait) {
    int status = 0;
    if (waitpid(child, &status, WNOHANG) == child) {
      return WIFEXITED(status) ? WEXITSTATUS(status) : 1000 + WTERMSIG(status);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  return -1;
}

int sum_in_parallel() {
  std::atomic<int> sum{0};
  parallel_chunks(10, [&](std::int64_t chunk) { sum += static_cast<int>(chunk); }, 4);
  return sum;
}

TEST(Parallel, ForkAfterALoop) {
  expect_each_chunk_once(100, 4);
  EXPECT_EQ(run_in_child([] { return sum_in_parallel(); }), 45);
  EXPECT_EQ(sum_in_parallel(), 45);
}

#if !defined(__SANITIZE_ADDRESS__)  // ASan's allocator keeps the locks that other threads held
TEST(Parallel, ForkWhileAnotherThreadIsInALoop) {
  std::atomic<bool> stop{false};
  std::thread other([&stop] {
    while (!stop) sum_in_parallel();
  });
  for (int repeat = 0; repeat < 50; ++repeat) {
    const int sum = run_in_child([] { return sum_in_parallel(); });
    EXPECT_EQ(sum, 45);
    if (sum != 45) break;
  }
  stop = true;
  other.join();
}
#endif

// A child that was forked off by a task has lost the workers and their share: with one thread it
// goes on, with more it raises, and its next loop works.
TEST(Parallel, ForkInsideALoop) {
  const pid_t parent = getpid();
  const std::thread::id caller = std::this_thread::get_id();
  for (const int threads : {1, 4}) {
    pid_t child = -1;
    std::atomic<bool> forked{false};
    bool raised = false;
    try {
      parallel_chunks(
          200,
          [&](std::int64_t) {
            std::this_thread::sleep_for(std::chrono::milliseconds(1));
            if (std::this_thread::get_id() == caller && !forked.exchange(true)) child = fork();
          },
          threads);
    } catch (const std::runtime_error&) {
      raised = true;
    }
    if (getpid() != parent) _exit(raised == (threads > 1) && sum_in_parallel() == 45 ? 0 : 1);
    EXPECT_FALSE(raised);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  }
}
#endif

TEST(Threads, SetAndRefused) {
  const int before = substep::num_threads();
  substep::set_num_threads(3);
  EXPECT_EQ(substep::num_threads(), 3);
  for (const int wrong : {0, -1, 1025}) {
    EXPECT_THROW(substep::set_num_threads(wrong), substep::InputError);
  }
  substep::set_num_threads(before);
}

// Plain integers here, too; with sleep, so that the workers have time to come.
TEST(Phases, BeginWhenAllOfTheOneBeforeHasRun) {
  const std::vector<std::int64_t> chunks{7, 0, 40, 1, 13};
  for (const int threads : {1, 2, 4}) {
    std::vector<std::vector<int>> ran;
    for (const std::int64_t count : chunks) ran.emplace_back(usize(count));
    std::atomic<int> early{0};
    substep::parallel_phases(
        chunks,
        [&](std::int64_t phase, std::int64_t chunk) {
          for (std::size_t p = 0; p < usize(phase); ++p) {
            if (std::accumulate(ran[p].begin(), ran[p].end(), 0) != chunks[p]) ++early;
          }
          ++ran[usize(phase)][usize(chunk)];
          std::this_thread::sleep_for(std::chrono::microseconds(100));
        },
        threads);
    EXPECT_EQ(early, 0);
    for (std::size_t p = 0; p < chunks.size(); ++p) {
      EXPECT_EQ(ran[p], std::vector<int>(usize(chunks[p]), 1));
    }
  }
}

TEST(Phases, EndWithTheFirstThatFails) {
  const std::vector<std::int64_t> chunks{5, 20, 5};
  for (const int threads : {1, 2, 4}) {
    std::atomic<int> later{0};
    std::string what;
    try {
      substep::parallel_phases(
          chunks,
          [&](std::int64_t phase, std::int64_t chunk) {
            if (phase == 2) ++later;
            if (phase == 1 && chunk >= 3) throw std::runtime_error(std::to_string(chunk));
          },
          threads);
    } catch (const std::runtime_error& error) {
      what = error.what();
    }
    EXPECT_EQ(what, "3");
    EXPECT_EQ(later, 0);
  }
}

}  // namespace
