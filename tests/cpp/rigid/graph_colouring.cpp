#include "substep/rigid/solver/graph_colouring.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep::rigid;

std::vector<BodyPair> random_pairs(int count, int bodies, std::uint32_t seed, double ground = 0.1) {
  std::mt19937 generator(seed);
  std::uniform_int_distribution<std::int32_t> body(0, bodies - 1);
  std::bernoulli_distribution on_ground(ground);
  std::vector<BodyPair> pairs;
  while (static_cast<int>(pairs.size()) < count) {
    BodyPair pair{body(generator), body(generator)};
    if (on_ground(generator)) pair.b = -1;
    if (pair.a != pair.b) pairs.push_back(pair);
  }
  return pairs;
}

struct Coloured {
  std::vector<std::uint8_t> colours;
  Sweep sweep;
};

Coloured sweep_of(const std::vector<BodyPair>& pairs, int bodies, int lanes,
                  std::vector<std::uint8_t> colours = {}) {
  GraphColouring colouring;
  Coloured result;
  result.colours = std::move(colours);
  result.colours.resize(pairs.size(), GraphColouring::kNoColour);
  colouring.colour(pairs, bodies, result.colours);
  colouring.make_sweep(pairs, bodies, result.colours, lanes, result.sweep);
  return result;
}

// That the bodies of the packets [begin, end) are all different, or those of each packet are.
void expect_apart(const Sweep& sweep, const std::vector<BodyPair>& pairs, std::int64_t begin,
                  std::int64_t end, std::set<std::int32_t>& bodies, bool fresh_per_packet) {
  for (std::int64_t packet = begin; packet < end; ++packet) {
    if (fresh_per_packet) bodies.clear();
    for (int lane = 0; lane < sweep.lanes; ++lane) {
      const std::int32_t c = sweep.constraint[usize(packet * sweep.lanes + lane)];
      if (c < 0) continue;
      for (const std::int32_t body : {pairs[usize(c)].a, pairs[usize(c)].b}) {
        if (body >= 0) {
          EXPECT_TRUE(bodies.insert(body).second) << body;
        }
      }
    }
  }
}

// Every constraint once; no body twice in a packet, nor in two chunks of a phase.
void check(const Sweep& sweep, const std::vector<BodyPair>& pairs) {
  std::vector<std::int32_t> seen;
  for (const std::int32_t c : sweep.constraint) {
    if (c >= 0) seen.push_back(c);
  }
  std::sort(seen.begin(), seen.end());
  ASSERT_EQ(seen.size(), pairs.size());
  for (std::size_t c = 0; c < seen.size(); ++c) EXPECT_EQ(seen[c], static_cast<std::int32_t>(c));
  std::set<std::int32_t> bodies;
  expect_apart(sweep, pairs, 0, sweep.packets(), bodies, true);
  ASSERT_EQ(sweep.phase_start.size(), sweep.chunks_of_phase.size() + 1);
  for (std::size_t f = 0; f < sweep.chunks_of_phase.size(); ++f) {
    EXPECT_EQ(sweep.chunks_of_phase[f], sweep.phase_start[f + 1] - sweep.phase_start[f]);
    EXPECT_GT(sweep.chunks_of_phase[f], 0);
    if (sweep.chunks_of_phase[f] == 1) continue;
    bodies.clear();
    const auto chunk = [&](std::size_t phase) {
      return sweep.chunk_start[usize(sweep.phase_start[phase])];
    };
    expect_apart(sweep, pairs, chunk(f), chunk(f + 1), bodies, false);
  }
  EXPECT_EQ(sweep.chunk_start.back(), sweep.packets());
}

TEST(GraphColouring, NoTwoOfAColourShareABody) {
  for (const int count : {0, 1, 7, 300, 5000}) {
    for (const int lanes : {1, 4, 8}) {
      const auto pairs = random_pairs(count, 1000, 3);
      const auto [colours, sweep] = sweep_of(pairs, 1000, lanes);
      check(sweep, pairs);
      std::set<std::pair<int, std::int32_t>> held;
      for (std::size_t c = 0; c < pairs.size(); ++c) {
        const bool ground = pairs[c].b < 0;
        ASSERT_NE(colours[c], GraphColouring::kNoColour);
        EXPECT_EQ(colours[c] >= GraphColouring::kPairColours, ground);
        EXPECT_TRUE(held.insert({colours[c], pairs[c].a}).second);
        EXPECT_TRUE(ground || held.insert({colours[c], pairs[c].b}).second);
      }
    }
  }
}

TEST(GraphColouring, TakesTheLeastColour) {
  // A chain of bodies: two colours; and the feet come last.
  std::vector<BodyPair> pairs{{0, -1}};
  for (std::int32_t i = 0; i < 9; ++i) pairs.push_back({i, i + 1});
  pairs.push_back({-1, 9});
  const auto [colours, sweep] = sweep_of(pairs, 10, 4);
  EXPECT_EQ(colours.front(), GraphColouring::kPairColours);
  EXPECT_EQ(colours.back(), GraphColouring::kPairColours);
  for (std::size_t c = 1; c < 10; ++c) EXPECT_EQ(colours[c], (c + 1) % 2);
  EXPECT_EQ(sweep.constraint,
            (std::vector<std::int32_t>{1, 3, 5, 7, 9, -1, -1, -1, 2, 4, 6, 8, 0, 10, -1, -1}));
  EXPECT_EQ(sweep.chunks_of_phase, (std::vector<std::int64_t>{1}));
}

TEST(GraphColouring, LargeColoursAreCutIntoChunks) {
  std::vector<BodyPair> pairs;
  for (std::int32_t i = 0; i < 1000; ++i) pairs.push_back({2 * i, 2 * i + 1});
  const Sweep sweep = sweep_of(pairs, 2000, 4).sweep;
  check(sweep, pairs);
  EXPECT_EQ(sweep.packets(), 250);
  EXPECT_EQ(sweep.chunks_of_phase, (std::vector<std::int64_t>{16}));
}

TEST(GraphColouring, ABodyWithMoreContactsThanColours) {
  std::vector<BodyPair> pairs;
  for (std::int32_t i = 1; i <= 3000; ++i) pairs.push_back({i % 2 ? 0 : i, i % 2 ? i : 0});
  for (std::int32_t i = 0; i < 200; ++i) pairs.push_back({0, -1});
  const auto [colours, sweep] = sweep_of(pairs, 3001, 8);
  check(sweep, pairs);
  EXPECT_EQ(std::count(colours.begin(), colours.end(), GraphColouring::kNoColour), 3072);
  EXPECT_EQ(sweep.packets(), 3200);  // every constraint shares body 0
  // Uncoloured ones among other bodies fill the lanes of those packets.
  auto more = pairs;
  for (std::int32_t k = 0; k < 70; ++k) {
    for (std::int32_t i = 0; i < 7; ++i) more.push_back({3001 + i, 3008 + i});
  }
  const auto other = sweep_of(more, 3015, 8);
  check(other.sweep, more);
  EXPECT_EQ(other.sweep.packets(), 3200);
}

TEST(GraphColouring, KeepsColours) {
  auto pairs = random_pairs(2000, 500, 5);
  auto colours = sweep_of(pairs, 500, 8).colours;
  std::mt19937 generator(1);
  for (int step = 0; step < 20; ++step) {
    // Every tenth goes, as many come in its place.
    const auto fresh = random_pairs(200, 500, 100 + static_cast<std::uint32_t>(step));
    for (const BodyPair& pair : fresh) {
      const std::size_t c = generator() % pairs.size();
      pairs[c] = pair;
      colours[c] = GraphColouring::kNoColour;
    }
    const auto result = sweep_of(pairs, 500, 8, colours);
    check(result.sweep, pairs);
    for (std::size_t c = 0; c < pairs.size(); ++c) {
      if (colours[c] != GraphColouring::kNoColour) {
        EXPECT_EQ(colours[c], result.colours[c]);
      }
    }
    colours = result.colours;
  }
  // Colours do not pile up: about as many as when coloured afresh (greedy).
  const auto most = [](const std::vector<std::uint8_t>& of) {
    int top = 0;
    for (const int c : of) top = std::max(top, c < GraphColouring::kPairColours ? c : 0);
    return top;
  };
  EXPECT_LE(most(colours), most(sweep_of(pairs, 500, 8).colours) + 4);
}

TEST(GraphColouring, ColoursThatConflictAreGivenAnew) {
  const std::vector<BodyPair> pairs{{0, 1}, {1, 2}, {2, -1}, {3, -1}};
  // The second would share body 1, the third has no colour of the ground, the fourth no colour.
  const auto colours = sweep_of(pairs, 4, 4, {5, 5, 5, 200}).colours;
  EXPECT_EQ(colours, (std::vector<std::uint8_t>{5, 0, 64, 64}));
}

TEST(GraphColouring, TwoUnmovableBodies) {
  EXPECT_THROW(sweep_of({{-1, -1}}, 1, 4), substep::InputError);
}

// A sweep whose result depends on the order: the same bits for any number of threads.
TEST(GraphColouring, SweepsAreTheSameForAnyThreads) {
  const auto pairs = random_pairs(20000, 3000, 9);
  const Sweep sweep = sweep_of(pairs, 3000, 8).sweep;
  EXPECT_GT(std::count_if(sweep.chunks_of_phase.begin(), sweep.chunks_of_phase.end(),
                          [](std::int64_t chunks) { return chunks > 1; }),
            5);
  const auto run = [&](int threads) {
    std::vector<double> value(3000);
    for (std::size_t i = 0; i < value.size(); ++i) value[i] = static_cast<double>(i);
    substep::parallel_phases(
        sweep.chunks_of_phase,
        [&](std::int64_t phase, std::int64_t chunk) {
          const auto c = usize(sweep.phase_start[usize(phase)] + chunk);
          for (std::int64_t at = sweep.chunk_start[c] * 8; at < sweep.chunk_start[c + 1] * 8;
               ++at) {
            const std::int32_t k = sweep.constraint[usize(at)];
            if (k < 0) continue;
            const auto [a, b] = pairs[usize(k)];
            double& u = value[usize(a)];
            if (b < 0) {
              u *= 0.7;
            } else {
              double& v = value[usize(b)];
              const double mean = 0.4 * u + 0.6 * v;
              v = u;
              u = mean;
            }
          }
        },
        threads);
    return value;
  };
  const auto one = run(1);
  for (const int threads : {2, 3, 4}) EXPECT_EQ(run(threads), one);
}

}  // namespace
