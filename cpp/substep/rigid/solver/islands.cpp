#include "substep/rigid/solver/islands.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/reserve.h"
#include "substep/core/usize.h"

namespace substep::rigid {

void label_islands(std::span<const BodyPair> constraints, std::span<std::int32_t> label) {
  std::iota(label.begin(), label.end(), 0);
  const auto parent = [&](std::int32_t i) -> std::int32_t& { return label[usize(i)]; };
  const auto root = [&](std::int32_t i) {
    while (parent(i) != i) i = parent(i) = parent(parent(i));
    return i;
  };
  for (const BodyPair& pair : constraints) {
    if (pair.a < 0 || pair.b < 0) continue;
    const std::int32_t p = root(pair.a), q = root(pair.b);
    parent(std::max(p, q)) = std::min(p, q);
  }
  // A parent is smaller than its children, and has its final label before them.
  for (std::int32_t& l : label) l = parent(l);
}

void Islands::gather_awake() {
  awake_.clear();
  for (std::size_t i = 0; i < island_.size(); ++i) {
    if (island_[i] == kAwake) awake_.push_back(static_cast<std::int32_t>(i));
  }
}

void Islands::make_room(std::int32_t end, std::int32_t count) {
  const auto n = usize(end);
  reserve_amortised(slow_time_, n), reserve_amortised(island_, n), reserve_amortised(next_, n);
  reserve_amortised(awake_, awake_.size() + usize(count));
}

void Islands::add(std::int32_t body) {
  if (body < 0) throw InputError("the number of a body must not be negative");
  const auto i = usize(body);
  if (i >= island_.size()) {
    slow_time_.resize(i + 1, 0);
    island_.resize(i + 1, kNoBody);
    next_.resize(i + 1, -1);
  }
  if (island_[i] != kNoBody) throw InputError("the body is there already");
  slow_time_[i] = 0;
  island_[i] = kAwake;
  awake_.insert(std::lower_bound(awake_.begin(), awake_.end(), body), body);
}

void Islands::remove(std::int32_t body) {
  const auto i = usize(body);
  if (body < 0 || i >= island_.size() || island_[i] == kNoBody) {
    throw InputError("there is no such body");
  }
  wake(body);
  slow_time_[i] = 0;
  island_[i] = kNoBody;
  awake_.erase(std::lower_bound(awake_.begin(), awake_.end(), body));
}

void Islands::renumber(std::span<const std::int32_t> bodies) {
  std::vector<double> slow_time;
  std::vector<std::int32_t> island;
  for (std::size_t i = 0; i < island_.size(); ++i) {
    if (island_[i] == kNoBody) continue;
    const auto to = usize(bodies[i]);
    slow_time.resize(to + 1, 0);
    island.resize(to + 1, kNoBody);
    slow_time[to] = slow_time_[i];
    island[to] = island_[i] < 0 ? island_[i] : bodies[usize(island_[i])];
  }
  restore(slow_time, island);
}

void Islands::wake(std::int32_t body) {
  const auto first = usize(body);
  slow_time_[first] = 0;
  if (!asleep(body)) return;
  const auto known = static_cast<std::ptrdiff_t>(woken_.size());
  std::int32_t member = body;
  do {
    const auto i = usize(member);
    woken_.push_back(member);
    slow_time_[i] = 0;
    island_[i] = kAwake;
    member = std::exchange(next_[i], -1);
  } while (member != body);
  std::sort(woken_.begin() + known, woken_.end());
  const auto before = static_cast<std::ptrdiff_t>(awake_.size());
  awake_.insert(awake_.end(), woken_.begin() + known, woken_.end());
  std::inplace_merge(awake_.begin(), awake_.begin() + before, awake_.end());
}

void Islands::update(double dt, const Sleep& sleep, std::span<const double> speed,
                     std::span<const BodyPair> constraints) {
  slept_.clear();
  woken_.clear();
  bool any = false;
  for (const std::int32_t body : awake_) {
    const auto i = usize(body);
    slow_time_[i] = speed[i] < sleep.speed ? slow_time_[i] + dt : 0;
    any |= slow_time_[i] >= sleep.time;
  }
  if (!any) return;

  // An island whose bodies are all ready is connected by constraints between ready ones.
  const auto ready = [&](std::int32_t body) {
    const auto i = usize(body);
    return island_[i] == kAwake && slow_time_[i] >= sleep.time;
  };
  ready_pairs_.clear();
  for (const BodyPair& pair : constraints) {
    if (pair.a >= 0 && pair.b >= 0 && ready(pair.a) && ready(pair.b)) ready_pairs_.push_back(pair);
  }
  label_.resize(island_.size());
  label_islands(ready_pairs_, label_);
  restless_.assign(island_.size(), 0);
  for (const BodyPair& pair : constraints) {
    if (pair.a < 0 || pair.b < 0 || ready(pair.a) == ready(pair.b)) continue;
    const std::int32_t body = ready(pair.a) ? pair.a : pair.b;
    restless_[usize(label_[usize(body)])] = 1;
  }
  last_.resize(island_.size());
  for (const std::int32_t body : awake_) {
    const auto i = usize(body);
    const std::int32_t label = label_[i];
    if (!ready(body) || restless_[usize(label)] != 0) continue;
    slept_.push_back(body);
    if (label != body) next_[usize(last_[usize(label)])] = body;
    last_[usize(label)] = body;
    next_[i] = label;  // until another follows
  }
  if (slept_.empty()) return;
  for (const std::int32_t body : slept_) {
    island_[usize(body)] = label_[usize(body)];
  }
  gather_awake();
}

void Islands::restore(std::span<const double> slow_time, std::span<const std::int32_t> island) {
  if (slow_time.size() != island.size()) throw InputError("the times and islands must be as many");
  std::vector<std::int32_t> next(island.size(), -1), last(island.size(), -1);
  for (std::size_t i = 0; i < island.size(); ++i) {
    const std::int32_t label = island[i], body = static_cast<std::int32_t>(i);
    if (label < 0) {
      if (label < kNoBody) throw InputError("there is no island of that number");
      continue;
    }
    if (label > body || island[usize(label)] != label) {
      throw InputError("an island must have the number of its first body");
    }
    std::int32_t& end = last[usize(label)];
    if (end >= 0) next[usize(end)] = body;
    end = body;
    next[i] = label;
  }
  slow_time_.assign(slow_time.begin(), slow_time.end());
  island_.assign(island.begin(), island.end());
  next_.swap(next);
  slept_.clear();
  woken_.clear();
  gather_awake();
}

}  // namespace substep::rigid
