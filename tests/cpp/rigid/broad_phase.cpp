#include "substep/rigid/collision/broad_phase.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <set>

#include "substep/core/errors.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep::rigid;
using Ids = std::set<std::pair<std::int32_t, std::int32_t>>;
using Draw = std::uniform_real_distribution<double>;

bool overlap(const Bounds& a, const Bounds& b) {
  return (a.low.array() <= b.high.array()).all() && (b.low.array() <= a.high.array()).all();
}

// Boxes of many sizes that fly about, come and go, fall asleep; every fifth is static, every
// seventh kinematic, three in a row are of one body; two planes.
class Scene {
 public:
  static constexpr int kPlanes = 2;

  explicit Scene(int count, std::uint32_t seed = 1) : generator_(seed) {
    bounds_.resize(usize(count + kPlanes));
    fixtures_.resize(usize(count));
    for (std::int32_t f = 0; f < count; ++f) add(f);
    broad_phase.add_plane(count, {-1, Motion::kStatic, 1, ~0u}, Vec3(0, 0, 1), 0.5);
    broad_phase.add_plane(count + 1, {-1, Motion::kStatic, 2, ~0u}, normal(), -1);
  }

  static Vec3 normal() { return Vec3(1, 2, -2) / 3; }

  void move() {
    for (std::size_t f = 0; f < fixtures_.size(); ++f) {
      Fixture_& fixture = fixtures_[f];
      if (!fixture.there || !fixture.awake || fixture.proxy.motion == Motion::kStatic) continue;
      fixture.centre += fixture.velocity;
      for (int i = 0; i < 3; ++i) {
        if (std::abs(fixture.centre[i]) > 5) fixture.velocity[i] *= -1;
      }
      if (draw(0, 1) < 0.01) fixture.centre = place();  // by hand, far away
    }
  }

  // Some go, some of these come back at once, others later; some fall asleep or wake.
  void change() {
    for (std::size_t f = 0; f < fixtures_.size(); ++f) {
      const auto id = static_cast<std::int32_t>(f);
      Fixture_& fixture = fixtures_[f];
      const double luck = draw(0, 1);
      if (!fixture.there) {
        if (luck < 0.3) add(id);
      } else if (luck < 0.06) {
        broad_phase.remove(id);
        fixture.there = false;
        if (luck < 0.03) add(id);
      } else if (luck < 0.16 && fixture.proxy.motion == Motion::kDynamic) {
        fixture.awake = !fixture.awake;
        broad_phase.set_awake(id, fixture.awake);
      }
    }
  }

  void update(int threads = 1) {
    std::vector<std::int32_t> moving;
    for (std::size_t f = 0; f < fixtures_.size(); ++f) {
      if (!fixtures_[f].there) continue;
      bounds_[f] = bounds_of(static_cast<std::int32_t>(f));
      if (fixtures_[f].awake) moving.push_back(static_cast<std::int32_t>(f));
    }
    broad_phase.update(moving, bounds_, threads);
  }

  // Pairs whose own bounds overlap, by trying all; awake or asleep.
  Ids touching(bool awake) const {
    Ids ids;
    const auto n = static_cast<std::int32_t>(fixtures_.size());
    for (std::int32_t a = 0; a < n; ++a) {
      for (std::int32_t b = a + 1; b < n + kPlanes; ++b) {
        if (!may(a, b) || is_awake(a, b) != awake) continue;
        const bool near = b < n ? overlap(bounds_of(a), bounds_of(b)) : below(a, b - n);
        if (near) ids.insert({a, b});
      }
    }
    return ids;
  }

  bool may(std::int32_t a, std::int32_t b) const {
    const auto n = static_cast<std::int32_t>(fixtures_.size());
    if (!at(a).there || (b < n && !at(b).there)) return false;
    const BroadPhase::Proxy p = at(a).proxy;
    const BroadPhase::Proxy q =
        b < n ? at(b).proxy : BroadPhase::Proxy{-1, Motion::kStatic, b == n ? 1u : 2u, ~0u};
    return p.body != q.body && (p.motion == Motion::kDynamic || q.motion == Motion::kDynamic) &&
           (p.group & q.mask) != 0 && (q.group & p.mask) != 0 &&
           excluded.count({std::min(p.body, q.body), std::max(p.body, q.body)}) == 0;
  }

  bool is_awake(std::int32_t a, std::int32_t b) const {
    const auto n = static_cast<std::int32_t>(fixtures_.size());
    return at(a).awake || (b < n && at(b).awake);
  }

  Bounds bounds_of(std::int32_t f) const {
    return {at(f).centre - at(f).half, at(f).centre + at(f).half};
  }

  // Whether the pair is near enough to be one: each box has at most this much room.
  bool plausible(std::int32_t a, std::int32_t b) const {
    if (b >= static_cast<std::int32_t>(fixtures_.size())) return true;
    const auto wide = [&](std::int32_t f) {
      return Bounds{at(f).centre - 3.1 * at(f).half, at(f).centre + 3.1 * at(f).half};
    };
    return overlap(wide(a), wide(b));
  }

  double draw(double low, double high) { return Draw(low, high)(generator_); }

  BroadPhase broad_phase;
  Ids excluded;

 private:
  struct Fixture_ {
    bool there = false, awake = true;
    BroadPhase::Proxy proxy;
    Vec3 centre, half, velocity;
  };
  const Fixture_& at(std::int32_t f) const { return fixtures_[usize(f)]; }
  Vec3 place() { return {draw(-5, 5), draw(-5, 5), draw(-5, 5)}; }

  bool below(std::int32_t a, std::int32_t plane) const {
    const Bounds box = bounds_of(a);
    if (plane == 0) return box.low.z() <= 0.5;
    return normal().dot(Vec3(box.low.x(), box.low.y(), box.high.z())) <= -1;
  }

  void add(std::int32_t f) {
    Fixture_& fixture = fixtures_[usize(f)];
    fixture.there = true;
    fixture.centre = place();
    const double size = std::exp(draw(std::log(0.05), std::log(1.0)));
    fixture.half = size * Vec3(draw(0.3, 1), draw(0.3, 1), draw(0.3, 1));
    fixture.velocity = Vec3(draw(-1, 1), draw(-1, 1), draw(-1, 1)) * 0.1;
    fixture.proxy = {f / 3,
                     f / 3 % 5 == 0   ? Motion::kStatic
                     : f / 3 % 7 == 0 ? Motion::kKinematic
                                      : Motion::kDynamic,
                     1u << f % 3, f % 11 == 0 ? 5u : ~0u};
    fixture.awake = fixture.proxy.motion != Motion::kStatic;
    broad_phase.add(f, fixture.proxy, bounds_of(f));
  }

  std::mt19937 generator_;
  std::vector<Fixture_> fixtures_;
  std::vector<Bounds> bounds_;
};

Ids ids_of(std::span<const FixturePair> pairs) {
  Ids ids;
  for (const FixturePair& pair : pairs) ids.insert({pair.a, pair.b});
  return ids;
}

// Sorted, none twice, all that touch, none that may not.
void expect_complete(const Scene& scene, std::span<const FixturePair> pairs, bool awake) {
  for (std::size_t k = 1; k < pairs.size(); ++k) {
    EXPECT_LT(std::pair(pairs[k - 1].a, pairs[k - 1].b), std::pair(pairs[k].a, pairs[k].b));
  }
  for (const FixturePair& pair : pairs) {
    EXPECT_LT(pair.a, pair.b);
    EXPECT_TRUE(scene.may(pair.a, pair.b));
    EXPECT_EQ(scene.is_awake(pair.a, pair.b), awake);
    EXPECT_TRUE(scene.plausible(pair.a, pair.b));
  }
  const Ids found = ids_of(pairs), touching = scene.touching(awake);
  for (const auto& [a, b] : touching) {
    EXPECT_EQ(found.count({a, b}), 1u) << "of " << a << " and " << b;
  }
}

TEST(BroadPhase, AllPairsOfRandomScenes) {
  for (const int count : {1, 40, 300}) {
    Scene scene(count);
    std::map<std::pair<std::int32_t, std::int32_t>, std::int32_t> slot;
    std::size_t seen = 0;
    for (int step = 0; step < 60; ++step) {
      if (step % 3 == 2) scene.change();
      if (step > 0) scene.move();
      if (step == 20) {
        scene.excluded = {{-1, 3}, {4, 6}, {1, 2}};
        scene.broad_phase.exclude({{3, -1}, {4, 6}, {1, 2}, {2, 1}});
      }
      if (step == 40) {
        scene.excluded = {{1, 2}};
        scene.broad_phase.exclude({{2, 1}});
      }
      scene.update();
      SCOPED_TRACE(step);
      const BroadPhase& broad = scene.broad_phase;
      expect_complete(scene, broad.pairs(), true);
      expect_complete(scene, broad.sleeping_pairs(), false);
      seen += scene.touching(true).size() + scene.touching(false).size();
      // Begun and ended are the difference to the last step, and slots stay.
      for (const FixturePair& pair : broad.ended()) {
        ASSERT_EQ(slot.count({pair.a, pair.b}), 1u);
        EXPECT_EQ(slot.at({pair.a, pair.b}), pair.slot);
        slot.erase({pair.a, pair.b});
      }
      for (const FixturePair& pair : broad.begun()) {
        EXPECT_TRUE(slot.insert({{pair.a, pair.b}, pair.slot}).second);
      }
      std::map<std::pair<std::int32_t, std::int32_t>, std::int32_t> now;
      std::set<std::int32_t> slots;
      for (const auto pairs : {broad.pairs(), broad.sleeping_pairs()}) {
        for (const FixturePair& pair : pairs) {
          now[{pair.a, pair.b}] = pair.slot;
          EXPECT_TRUE(slots.insert(pair.slot).second);
          EXPECT_LT(pair.slot, broad.slots());
        }
      }
      EXPECT_EQ(now, slot);
    }
    if (count == 300) {
      EXPECT_GT(seen, 10000u);
    }
  }
}

TEST(BroadPhase, TheSameForAnyThreads) {
  std::vector<FixturePair> expected;
  for (const int threads : {1, 2, 3, 4}) {
    Scene scene(2000, 5);
    std::vector<FixturePair> pairs;
    for (int step = 0; step < 12; ++step) {
      if (step % 4 == 3) scene.change();
      if (step > 0) scene.move();
      scene.update(threads);
      for (const auto list :
           {scene.broad_phase.pairs(), scene.broad_phase.begun(), scene.broad_phase.ended()}) {
        pairs.insert(pairs.end(), list.begin(), list.end());
      }
    }
    if (threads == 1) expected = pairs;
    ASSERT_EQ(pairs.size(), expected.size());
    for (std::size_t k = 0; k < pairs.size(); ++k) {
      EXPECT_EQ(std::tie(pairs[k].a, pairs[k].b, pairs[k].slot),
                std::tie(expected[k].a, expected[k].b, expected[k].slot));
    }
  }
}

TEST(BroadPhase, AFixtureThatStaysInItsBoxChangesNothing) {
  BroadPhase broad;
  std::vector<Bounds> bounds{{Vec3(0, 0, 0), Vec3(1, 1, 1)}, {Vec3(0.9, 0, 0), Vec3(2, 1, 1)}};
  broad.add(0, {0, Motion::kDynamic}, bounds[0]);
  broad.add(1, {1, Motion::kDynamic}, bounds[1]);
  const std::vector<std::int32_t> all{0, 1};
  broad.update(all, bounds);
  EXPECT_EQ(broad.begun().size(), 1u);
  bounds[0].low.z() -= 0.04;
  broad.update(all, bounds);
  EXPECT_EQ(broad.pairs().size(), 1u);
  EXPECT_TRUE(broad.begun().empty() && broad.ended().empty());
  bounds[0] = {Vec3(5, 0, 0), Vec3(6, 1, 1)};
  broad.update(all, bounds);
  EXPECT_TRUE(broad.pairs().empty());
  EXPECT_EQ(broad.ended().size(), 1u);
}

TEST(BroadPhase, StaticThatIsMovedIntoASleepingBody) {
  BroadPhase broad;
  std::vector<Bounds> bounds{{Vec3(0, 0, 0), Vec3(1, 1, 1)}, {Vec3(5, 0, 0), Vec3(6, 1, 1)}};
  broad.add(0, {0, Motion::kDynamic}, bounds[0]);
  broad.add(1, {-1, Motion::kStatic}, bounds[1]);
  broad.set_awake(0, false);
  broad.update({}, bounds);
  bounds[1] = {Vec3(0.5, 0, 0), Vec3(1.5, 1, 1)};
  const std::vector<std::int32_t> moved{1};
  broad.update(moved, bounds);
  EXPECT_EQ(broad.begun().size(), 1u);
  EXPECT_TRUE(broad.pairs().empty());
  EXPECT_EQ(broad.sleeping_pairs().size(), 1u);
  broad.set_awake(0, true);
  broad.update({}, bounds);
  EXPECT_EQ(broad.pairs().size(), 1u);
  bounds[1] = {Vec3(5, 0, 0), Vec3(6, 1, 1)};
  broad.set_awake(0, false);
  broad.update(moved, bounds);
  EXPECT_EQ(broad.ended().size(), 1u);
  EXPECT_TRUE(broad.sleeping_pairs().empty());
}

// The same scene twice, with and without new numbers after fixtures were removed.
TEST(BroadPhase, NewNumbers) {
  std::mt19937 generator(2);
  const auto draw = [&](double low, double high) { return Draw(low, high)(generator); };
  const std::int32_t n = 300;
  std::vector<Vec3> centre, velocity;
  BroadPhase plain, compact;
  std::vector<std::int32_t> number(usize(n));  // in `compact`; -1: removed
  std::vector<Bounds> bounds(usize(n));
  const auto bounds_at = [&](std::size_t f) {
    return Bounds{centre[f] - Vec3::Constant(0.3), centre[f] + Vec3::Constant(0.3)};
  };
  for (std::int32_t f = 0; f < n; ++f) {
    const auto i = usize(f);
    centre.push_back({draw(-2, 2), draw(-2, 2), draw(-2, 2)});
    velocity.push_back(0.1 * Vec3(draw(-1, 1), draw(-1, 1), draw(-1, 1)));
    number[i] = f;
    if (f == 7) {
      for (BroadPhase* broad : {&plain, &compact}) {
        broad->add_plane(f, {-1, Motion::kStatic}, Vec3::UnitZ(), 0);
      }
      continue;
    }
    bounds[i] = bounds_at(i);
    const Motion motion = f % 4 == 0 ? Motion::kStatic : Motion::kDynamic;
    for (BroadPhase* broad : {&plain, &compact}) broad->add(f, {f, motion}, bounds[i]);
  }
  const std::vector<BodyPair> excluded{{5, 6}, {-1, 9}, {40, 41}, {20, 250}};
  plain.exclude(excluded);
  compact.exclude(excluded);
  std::size_t seen = 0;
  for (int step = 0; step < 15; ++step) {
    if (step > 0) {
      const std::int32_t old_count = 1 + *std::max_element(number.begin(), number.end());
      std::vector<std::int32_t> to(usize(old_count), -1);
      std::int32_t next = 0;
      for (std::int32_t f = 0; f < n; ++f) {
        const auto i = usize(f);
        if (number[i] < 0) continue;
        if (f != 7 && draw(0, 1) < 0.03) {
          plain.remove(f);
          compact.remove(number[i]);
          number[i] = -1;
        } else {
          to[usize(number[i])] = next;
          number[i] = next++;
        }
      }
      compact.renumber(to, to);  // bodies and fixtures have the same numbers here
    }
    std::vector<std::int32_t> moving, moving_compact;
    std::vector<Bounds> bounds_compact(bounds.size());
    for (std::int32_t f = 0; f < n; ++f) {
      const auto i = usize(f);
      if (number[i] < 0 || f == 7) continue;
      if (f % 4 != 0) centre[i] += velocity[i];
      bounds[i] = bounds_compact[usize(number[i])] = bounds_at(i);
      moving.push_back(f);
      moving_compact.push_back(number[i]);
    }
    plain.update(moving, bounds);
    compact.update(moving_compact, bounds_compact);
    Ids expected;
    for (const FixturePair& pair : plain.pairs()) {
      expected.insert({number[usize(pair.a)], number[usize(pair.b)]});
    }
    EXPECT_EQ(ids_of(compact.pairs()), expected) << step;
    EXPECT_TRUE(std::is_sorted(compact.pairs().begin(), compact.pairs().end(),
                               [](const FixturePair& p, const FixturePair& q) {
                                 return std::pair(p.a, p.b) < std::pair(q.a, q.b);
                               }));
    std::set<std::int32_t> slots;
    for (const FixturePair& pair : compact.pairs()) slots.insert(pair.slot);
    EXPECT_EQ(slots.size(), compact.pairs().size());
    seen += expected.size();
  }
  EXPECT_GT(seen, 3000u);
  const std::vector<std::int32_t> none(usize(n), -1);
  EXPECT_THROW(compact.renumber(none, none), substep::InputError);
  const std::vector<std::int32_t> same(usize(n), 0);
  EXPECT_THROW(compact.renumber(same, same), substep::InputError);
}

TEST(BroadPhase, CoincidentAndFarAway) {
  BroadPhase broad;
  std::vector<Bounds> bounds(210);
  std::vector<std::int32_t> all;
  for (std::int32_t f = 0; f < 210; ++f) {
    const double at = f < 100 ? 1e4 : f < 200 ? 1e300 : 1e7 + 8 * f;
    bounds[usize(f)] = {Vec3(at, at, at) - Vec3::Ones(), Vec3(at, at, at) + Vec3::Ones()};
    broad.add(f, {f, Motion::kDynamic}, bounds[usize(f)]);
    all.push_back(f);
  }
  broad.update(all, bounds);
  EXPECT_EQ(broad.pairs().size(), 2u * 100 * 99 / 2);
}

TEST(BroadPhase, RefusesWhatIsNotFinite) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  BroadPhase broad;
  std::vector<Bounds> bounds{{Vec3(0, 0, 0), Vec3(1, 1, 1)}, {Vec3(0.5, 0, 0), Vec3(2, 1, 1)}};
  EXPECT_THROW(broad.add(0, {}, {Vec3(0, kNaN, 0), Vec3(1, 1, 1)}), substep::InputError);
  broad.add(0, {0, Motion::kDynamic}, bounds[0]);
  broad.add(1, {1, Motion::kDynamic}, bounds[1]);
  EXPECT_THROW(broad.add(1, {}, bounds[1]), substep::InputError);
  EXPECT_THROW(broad.remove(2), substep::InputError);
  EXPECT_THROW(broad.add_plane(2, {-1, Motion::kDynamic}, Vec3(0, 0, 1), 0), substep::InputError);
  const std::vector<std::int32_t> all{0, 1};
  broad.update(all, bounds);
  auto wrong = bounds;
  wrong[0].low.x() += 50;
  wrong[0].high.x() += 50;
  wrong[1].high.z() = kNaN;
  try {
    broad.update(all, wrong);
    FAIL();
  } catch (const substep::NonFiniteError& error) {
    EXPECT_EQ(error.index, 1);
  }
  EXPECT_EQ(broad.pairs().size(), 1u);
  broad.update(all, bounds);
  EXPECT_EQ(broad.pairs().size(), 1u);
  EXPECT_TRUE(broad.begun().empty() && broad.ended().empty());
}

TEST(BroadPhase, OverlapAndWayAgainstBruteForce) {
  Scene scene(400, 3);
  for (int step = 0; step < 5; ++step) {
    scene.move();
    scene.update();
  }
  for (int k = 0; k < 200; ++k) {
    const Vec3 at(scene.draw(-6, 6), scene.draw(-6, 6), scene.draw(-6, 6));
    const Vec3 half = Vec3::Constant(scene.draw(0, 1));
    const Bounds box{at - half, at + half};
    const auto found = scene.broad_phase.overlapping(box);
    EXPECT_TRUE(std::is_sorted(found.begin(), found.end()));
    Vec3 direction(scene.draw(-1, 1), scene.draw(-1, 1), scene.draw(-1, 1));
    if (k % 5 == 0) direction = Vec3::Unit(k % 3);
    direction.normalize();
    const double length = scene.draw(0, 10);
    std::set<std::int32_t> met;
    scene.broad_phase.cast(at, direction, length, half, [&](std::int32_t fixture) {
      EXPECT_TRUE(met.insert(fixture).second);
      return length;
    });
    for (std::int32_t f = 0; f < 400; ++f) {
      const Bounds other = scene.bounds_of(f);
      if (overlap(box, other)) {
        EXPECT_TRUE(std::binary_search(found.begin(), found.end(), f));
      }
      // Slabs of the box made larger by the half lengths.
      double enter = 0, leave = length;
      for (int i = 0; i < 3; ++i) {
        const double low = other.low[i] - half[i] - at[i], high = other.high[i] + half[i] - at[i];
        if (direction[i] == 0) {
          if (low > 0 || high < 0) enter = 1e9;
          continue;
        }
        enter = std::max(enter, std::min(low / direction[i], high / direction[i]));
        leave = std::min(leave, std::max(low / direction[i], high / direction[i]));
      }
      if (enter <= leave) {
        EXPECT_EQ(met.count(f), 1u) << f;
      }
    }
    EXPECT_LT(met.size(), 402u);
    EXPECT_EQ(met.count(400) + met.count(401), 2u);
  }
}

}  // namespace
