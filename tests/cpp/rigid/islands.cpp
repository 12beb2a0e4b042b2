#include "substep/rigid/solver/islands.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>

#include "substep/core/errors.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep::rigid;
using List = std::vector<std::int32_t>;

List list(std::span<const std::int32_t> values) { return {values.begin(), values.end()}; }

Islands bodies(std::int32_t count) {
  Islands islands;
  for (std::int32_t i = 0; i < count; ++i) islands.add(i);
  return islands;
}

constexpr Islands::Sleep kSleep{0.05, 0.5};
constexpr double kStep = 0.125;  // four steps are the time to sleep

TEST(Islands, LabelsAreConnectedComponents) {
  std::mt19937 generator(3);
  for (int trial = 0; trial < 50; ++trial) {
    const int n = 60;
    std::uniform_int_distribution<std::int32_t> draw(-3, n - 1);
    std::vector<BodyPair> pairs(usize(trial * 2));
    for (BodyPair& pair : pairs) pair = {draw(generator), draw(generator)};
    List label(n);
    label_islands(pairs, label);
    // The same by spreading the least number until nothing changes.
    List expected(n);
    for (std::int32_t i = 0; i < n; ++i) expected[usize(i)] = i;
    for (bool changed = true; changed;) {
      changed = false;
      for (const auto [a, b] : pairs) {
        if (a < 0 || b < 0) continue;
        std::int32_t& p = expected[usize(a)];
        std::int32_t& q = expected[usize(b)];
        if (p != q) p = q = std::min(p, q), changed = true;
      }
    }
    EXPECT_EQ(label, expected);
    std::shuffle(pairs.begin(), pairs.end(), generator);
    List other(n);
    label_islands(pairs, other);
    EXPECT_EQ(label, other);
  }
}

TEST(Islands, SleepTogetherWhenAllHaveBeenSlow) {
  Islands islands = bodies(6);
  // 0-1-2 with the ground, 3-4 by a joint, 5 alone; 2 stops moving two steps later.
  const std::vector<BodyPair> pairs{{1, 0}, {0, -1}, {2, 1}, {4, 3}, {-1, 5}};
  std::vector<double> speed{0, 0.049, 0.05, 0, 0, 0.01};
  for (int step = 1; step <= 6; ++step) {
    if (step == 3) speed[2] = 0.04;
    islands.update(kStep, kSleep, speed, pairs);
    EXPECT_EQ(list(islands.slept()), step == 4   ? (List{3, 4, 5})
                                     : step == 6 ? (List{0, 1, 2})
                                                 : List{});
    EXPECT_EQ(list(islands.awake()), step < 4   ? (List{0, 1, 2, 3, 4, 5})
                                     : step < 6 ? (List{0, 1, 2})
                                                : List{});
  }
  EXPECT_EQ(list(islands.island()), (List{0, 0, 0, 3, 3, 5}));
}

TEST(Islands, GroundConnectsNothing) {
  Islands islands = bodies(2);
  const std::vector<BodyPair> pairs{{0, -1}, {1, -1}};
  for (int step = 0; step < 4; ++step) {
    islands.update(kStep, kSleep, std::vector<double>{0, 1}, pairs);
  }
  EXPECT_EQ(list(islands.slept()), List{0});
  EXPECT_TRUE(islands.asleep(0));
  EXPECT_FALSE(islands.asleep(1));
}

TEST(Islands, WakeTogether) {
  Islands islands = bodies(5);
  const std::vector<BodyPair> pairs{{0, 3}, {3, 4}, {1, 2}};
  const std::vector<double> still(5, 0.0);
  for (int step = 0; step < 4; ++step) islands.update(kStep, kSleep, still, pairs);
  EXPECT_TRUE(islands.awake().empty());
  islands.wake(3);
  EXPECT_EQ(list(islands.woken()), (List{0, 3, 4}));
  EXPECT_EQ(list(islands.awake()), (List{0, 3, 4}));
  islands.wake(2);
  EXPECT_EQ(list(islands.woken()), (List{0, 3, 4, 1, 2}));
  EXPECT_EQ(list(islands.awake()), (List{0, 1, 2, 3, 4}));
  // Their time begins anew.
  for (int step = 1; step <= 4; ++step) {
    EXPECT_EQ(islands.awake().size(), 5u);
    islands.update(kStep, kSleep, still, pairs);
    EXPECT_TRUE(islands.woken().empty());
  }
  EXPECT_TRUE(islands.awake().empty());
}

TEST(Islands, WakingAnAwakeBodyKeepsItsIslandUp) {
  Islands islands = bodies(2);
  const std::vector<BodyPair> pairs{{0, 1}};
  const std::vector<double> still(2, 0.0);
  for (int step = 0; step < 12; ++step) {
    if (step % 3 == 0) islands.wake(1);
    islands.update(kStep, kSleep, still, pairs);
    EXPECT_TRUE(islands.woken().empty());
    EXPECT_EQ(islands.awake().size(), 2u);
  }
}

TEST(Islands, AMovingKinematicBodyKeepsAwake) {
  Islands islands = bodies(3);
  const std::vector<BodyPair> pairs{{0, 1}, {1, -1}};
  const std::vector<double> speed{0, std::numeric_limits<double>::infinity(), 0};
  for (int step = 0; step < 10; ++step) islands.update(kStep, kSleep, speed, pairs);
  EXPECT_EQ(list(islands.awake()), (List{0, 1}));
}

TEST(Islands, ABodyThatComesToRestOnASleepingOne) {
  Islands islands = bodies(2);
  std::vector<double> speed{0, 3};
  for (int step = 0; step < 4; ++step) islands.update(kStep, kSleep, speed, {});
  EXPECT_EQ(list(islands.awake()), List{1});
  // It hits: the contact begins, and wakes.
  const std::vector<BodyPair> pairs{{0, 1}};
  islands.wake(0);
  speed[1] = 0;
  for (int step = 0; step < 3; ++step) islands.update(kStep, kSleep, speed, pairs);
  EXPECT_EQ(list(islands.awake()), (List{0, 1}));
  islands.update(kStep, kSleep, speed, pairs);
  EXPECT_EQ(list(islands.island()), (List{0, 0}));
}

TEST(Islands, RemovedBodies) {
  Islands islands = bodies(4);
  const std::vector<BodyPair> pairs{{0, 1}, {1, 2}, {2, 3}};
  const std::vector<double> still(4, 0.0);
  for (int step = 0; step < 4; ++step) islands.update(kStep, kSleep, still, pairs);
  islands.remove(1);
  EXPECT_EQ(list(islands.awake()), (List{0, 2, 3}));
  EXPECT_THROW(islands.remove(1), substep::InputError);
  EXPECT_THROW(islands.add(2), substep::InputError);
  EXPECT_THROW(islands.add(-1), substep::InputError);
  const std::vector<BodyPair> rest{{2, 3}};
  for (int step = 0; step < 4; ++step) islands.update(kStep, kSleep, still, rest);
  EXPECT_EQ(list(islands.island()), (List{0, Islands::kNoBody, 2, 2}));
  islands.add(1);
  EXPECT_EQ(list(islands.awake()), List{1});
}

TEST(Islands, NewNumbers) {
  Islands islands = bodies(6);
  const std::vector<BodyPair> pairs{{2, 5}, {3, 4}};
  const std::vector<double> speed{1, 0, 0, 0, 0, 0};
  for (int step = 0; step < 4; ++step) islands.update(kStep, kSleep, speed, pairs);
  islands.remove(1);
  islands.renumber(List{0, -1, 1, 2, 3, 4});
  EXPECT_EQ(list(islands.island()), (List{Islands::kAwake, 1, 2, 2, 1}));
  EXPECT_EQ(list(islands.awake()), List{0});
  EXPECT_TRUE(islands.woken().empty());
  islands.wake(4);
  EXPECT_EQ(list(islands.woken()), (List{1, 4}));
}

// Random graphs: who sleeps are the islands of label_islands() with all bodies slow; a restored
// copy goes the same way.
TEST(Islands, RandomGraphsAndRestoring) {
  std::mt19937 generator(11);
  const std::int32_t n = 80;
  Islands islands = bodies(n);
  std::uniform_int_distribution<std::int32_t> draw(0, n - 1);
  std::vector<double> speed(n), slow(n, 0.0);
  std::size_t slept = 0, woken = 0;
  for (int step = 0; step < 200; ++step) {
    for (auto& s : speed) s = generator() % 40 == 0 ? 1 : 0;
    std::vector<BodyPair> pairs(40);
    for (BodyPair& pair : pairs) pair = {draw(generator), draw(generator)};
    for (const auto [a, b] : pairs) {
      if (islands.asleep(a) != islands.asleep(b)) islands.wake(islands.asleep(a) ? a : b);
    }
    woken += islands.woken().size();
    for (const std::int32_t body : islands.woken()) slow[usize(body)] = 0;
    Islands copy;
    copy.restore(islands.slow_time(), islands.island());
    EXPECT_EQ(list(copy.awake()), list(islands.awake()));
    const List before = list(islands.awake());
    List label(n), expected;
    std::vector<bool> ready(n, true);
    label_islands(pairs, label);
    for (const std::int32_t body : before) {
      const auto i = usize(body);
      slow[i] = speed[i] < kSleep.speed ? slow[i] + kStep : 0;
      if (slow[i] < kSleep.time) ready[usize(label[i])] = false;
    }
    for (const std::int32_t body : before) {
      const auto i = usize(body);
      if (ready[usize(label[i])]) expected.push_back(body);
    }
    islands.update(kStep, kSleep, speed, pairs);
    EXPECT_EQ(list(islands.slept()), expected);
    slept += expected.size();
    std::shuffle(pairs.begin(), pairs.end(), generator);
    copy.update(kStep, kSleep, speed, pairs);
    EXPECT_EQ(list(copy.island()), list(islands.island()));
    EXPECT_TRUE(
        std::equal(copy.slow_time().begin(), copy.slow_time().end(), islands.slow_time().begin()));
    const std::int32_t poked = draw(generator);
    copy.wake(poked);
    islands.wake(poked);
    slow[usize(poked)] = 0;
    EXPECT_EQ(list(copy.awake()), list(islands.awake()));
    for (const std::int32_t body : islands.woken()) slow[usize(body)] = 0;
  }
  EXPECT_GT(slept, 200u);
  EXPECT_GT(woken, 200u);
}

TEST(Islands, RestoreRefusesWhatIsNoState) {
  Islands islands = bodies(2);
  const std::vector<double> time(3, 0.0);
  EXPECT_THROW(islands.restore(time, List{0, 0}), substep::InputError);
  EXPECT_THROW(islands.restore(time, List{1, 1, -1}), substep::InputError);
  EXPECT_THROW(islands.restore(time, List{-1, 0, -1}), substep::InputError);
  EXPECT_THROW(islands.restore(time, List{-1, -3, -1}), substep::InputError);
  EXPECT_THROW(islands.restore(time, List{7, -1, -1}), substep::InputError);
  EXPECT_EQ(list(islands.awake()), (List{0, 1}));
}

}  // namespace
