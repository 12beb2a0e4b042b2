#include "substep/rigid/collision/broad_phase.h"

#include <algorithm>
#include <cmath>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/reserve.h"
#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

constexpr double kRoom = 0.1;      // on each side of a fat box, of the mean half length
constexpr double kStepsAhead = 4;  // that a fixture goes on in its box at the speed it has
constexpr std::int64_t kCompared = 512, kQueried = 32;  // fixtures of a chunk

bool precedes(const FixturePair& p, const FixturePair& q) {
  return p.a != q.a ? p.a < q.a : p.b < q.b;
}

std::uint64_t key(std::int32_t a, std::int32_t b) {
  return std::uint64_t{static_cast<std::uint32_t>(std::min(a, b))} << 32 |
         static_cast<std::uint32_t>(std::max(a, b));
}

bool reaches(const TreeBox& box, const Vec3& normal, double offset) {
  double lowest = 0;
  for (int i = 0; i < 3; ++i) {
    lowest += std::min(normal[i] * double{box.low[i]}, normal[i] * double{box.high[i]});
  }
  return lowest <= offset;
}

// `steps`: since the centre was `before`.
TreeBox fat_box(const Bounds& bounds, const Vec3& before, double steps) {
  const Vec3 half = (bounds.high - bounds.low) / 2;
  const double room = kRoom * half.mean();
  const Vec3 way = (0.5 * (bounds.low + bounds.high) - before) * (kStepsAhead / steps);
  Bounds fat{bounds.low.array() - room, bounds.high.array() + room};
  for (int i = 0; i < 3; ++i) {
    (way[i] < 0 ? fat.low[i] : fat.high[i]) += std::clamp(way[i], -half[i], half[i]);
  }
  return tree_box(fat);
}

bool finite(const Bounds& bounds) { return bounds.low.allFinite() && bounds.high.allFinite(); }

}  // namespace

AabbTree& BroadPhase::tree(std::int32_t fixture) {
  return entries_[usize(fixture)].proxy.motion == Motion::kStatic ? ground_ : movable_;
}

// All pairs of the fixture end with the next update.
void BroadPhase::replace(std::int32_t fixture) {
  const auto f = usize(fixture);
  if (change_[f] == kSame) changed_.push_back(fixture);
  change_[f] = kReplaced;
  old_box_[f] = empty_tree_box();
}

BroadPhase::Entry& BroadPhase::enter(std::int32_t fixture, const Proxy& proxy, Kind kind) {
  if (fixture < 0) throw InputError("the number of a fixture must not be negative");
  const auto f = usize(fixture);
  if (f >= entries_.size()) {
    entries_.resize(f + 1);
    box_.resize(f + 1, empty_tree_box());
    old_box_.resize(f + 1, empty_tree_box());
    change_.resize(f + 1, kSame);
  }
  Entry& entry = entries_[f];
  if (entry.kind != Kind::kNone) throw InputError("the fixture is there already");
  entry.proxy = proxy;
  entry.kind = kind;
  entry.awake = proxy.motion != Motion::kStatic;
  entry.step = step_;
  replace(fixture);
  return entry;
}

void BroadPhase::make_room(std::int32_t end, std::int32_t count) {
  const auto n = usize(end), more = usize(count);
  reserve_amortised(entries_, n), reserve_amortised(change_, n);
  reserve_amortised(box_, n), reserve_amortised(old_box_, n);
  reserve_amortised(changed_, changed_.size() + more);
  reserve_amortised(planes_, planes_.size() + more);
  ground_.make_room(end, count), movable_.make_room(end, count);
}

void BroadPhase::add(std::int32_t fixture, const Proxy& proxy, const Bounds& bounds) {
  if (!finite(bounds)) throw InputError("the bounds of a fixture must be finite");
  Entry& entry = enter(fixture, proxy, Kind::kBox);
  entry.centre = 0.5 * (bounds.low + bounds.high);
  const auto f = usize(fixture);
  box_[f] = fat_box(bounds, entry.centre, 1);
  tree(fixture).add(fixture, box_[f]);
}

void BroadPhase::add_plane(std::int32_t fixture, const Proxy& proxy, const Vec3& normal,
                           double offset) {
  if (proxy.motion != Motion::kStatic) throw InputError("a plane must be of a static body");
  if (!normal.allFinite() || !std::isfinite(offset)) throw InputError("a plane must be finite");
  Entry& entry = enter(fixture, proxy, Kind::kPlane);
  entry.centre = normal;
  entry.offset = offset;
  planes_.insert(std::lower_bound(planes_.begin(), planes_.end(), fixture), fixture);
}

void BroadPhase::remove(std::int32_t fixture) {
  const auto f = usize(fixture);
  if (fixture < 0 || f >= entries_.size() || entries_[f].kind == Kind::kNone) {
    throw InputError("there is no such fixture");
  }
  replace(fixture);
  if (entries_[f].kind == Kind::kPlane) {
    planes_.erase(std::lower_bound(planes_.begin(), planes_.end(), fixture));
  } else {
    tree(fixture).remove(fixture);
  }
  box_[f] = empty_tree_box();
  entries_[f].kind = Kind::kNone;
  entries_[f].awake = false;
}

void BroadPhase::set_awake(std::int32_t fixture, bool awake) {
  Entry& entry = entries_[usize(fixture)];
  if (entry.awake == awake || entry.proxy.motion == Motion::kStatic) return;
  entry.awake = awake;
  sleep_changed_ = true;
}

void BroadPhase::exclude(std::vector<BodyPair> pairs) {
  std::vector<std::uint64_t> keys, differing;
  for (const BodyPair& pair : pairs) keys.push_back(key(pair.a, pair.b));
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  std::set_symmetric_difference(keys.begin(), keys.end(), excluded_.begin(), excluded_.end(),
                                std::back_inserter(differing));
  excluded_.swap(keys);
  // It is enough to look again at the fixtures of the first body of each.
  std::vector<std::int32_t> bodies;
  for (const std::uint64_t k : differing) bodies.push_back(static_cast<std::int32_t>(k >> 32));
  std::sort(bodies.begin(), bodies.end());
  if (bodies.empty()) return;
  for (std::size_t f = 0; f < entries_.size(); ++f) {
    if (entries_[f].kind != Kind::kNone &&
        std::binary_search(bodies.begin(), bodies.end(), entries_[f].proxy.body)) {
      replace(static_cast<std::int32_t>(f));
    }
  }
}

bool BroadPhase::may_touch(std::int32_t a, std::int32_t b) const {
  const Proxy& p = entries_[usize(a)].proxy;
  const Proxy& q = entries_[usize(b)].proxy;
  return p.body != q.body && (p.motion == Motion::kDynamic || q.motion == Motion::kDynamic) &&
         (p.group & q.mask) != 0 && (q.group & p.mask) != 0 &&
         (excluded_.empty() ||
          !std::binary_search(excluded_.begin(), excluded_.end(), key(p.body, q.body)));
}

bool BroadPhase::near(std::int32_t a, std::int32_t b, const std::vector<TreeBox>& boxes) const {
  const auto f = usize(a), g = usize(b);
  const Entry &p = entries_[f], &q = entries_[g];
  if (p.kind == Kind::kPlane) return reaches(boxes[g], p.centre, p.offset);
  if (q.kind == Kind::kPlane) return reaches(boxes[f], q.centre, q.offset);
  return boxes[f].overlaps(boxes[g]);
}

void BroadPhase::find_left(std::span<const std::int32_t> moving, std::span<const Bounds> bounds,
                           int threads) {
  const auto n = static_cast<std::int64_t>(moving.size());
  left_.resize(usize((n + kCompared - 1) / kCompared));
  parallel_for(
      n, kCompared,
      [&](std::int64_t begin, std::int64_t end) {
        auto& left = left_[usize(begin / kCompared)];
        left.clear();
        for (std::int64_t k = begin; k < end; ++k) {
          const std::int32_t fixture = moving[usize(k)];
          const auto f = usize(fixture);
          if (box_[f].holds(bounds[f]) || entries_[f].kind != Kind::kBox) continue;
          if (!finite(bounds[f])) {
            throw NonFiniteError("the position of a fixture is not finite", std::nan(""), fixture);
          }
          left.push_back(fixture);
        }
      },
      threads);
}

void BroadPhase::move_boxes(std::span<const Bounds> bounds) {
  ++step_;
  for (const auto& left : left_) {
    for (const std::int32_t fixture : left) {
      const auto f = usize(fixture);
      if (change_[f] == kSame) {
        change_[f] = kMoved;
        changed_.push_back(fixture);
      }
      Entry& entry = entries_[f];
      const auto steps = static_cast<double>(std::max<std::int64_t>(step_ - entry.step, 1));
      box_[f] = fat_box(bounds[f], entry.centre, steps);
      entry.centre = 0.5 * (bounds[f].low + bounds[f].high);
      entry.step = step_;
      tree(fixture).set(fixture, box_[f]);
    }
  }
  ground_.tidy();
  movable_.tidy();
}

void BroadPhase::find_new(std::int32_t fixture, std::vector<FixturePair>& found) const {
  const auto f = usize(fixture);
  if (entries_[f].proxy.group == 0 || entries_[f].proxy.mask == 0) return;  // touches nothing
  const auto consider = [&](std::int32_t other, auto&& were_near) {
    // Of two that changed the lower one finds the pair.
    const int change = change_[usize(other)];
    if (other == fixture || (change != kSame && other < fixture)) return;
    if (((change | change_[f]) & kReplaced) == 0 && were_near()) return;
    if (may_touch(fixture, other)) {
      found.push_back({std::min(fixture, other), std::max(fixture, other), -1});
    }
  };
  const auto take = [&](std::int32_t other) {
    const TreeBox& old = old_box_[usize(other)];
    consider(other, [&] { return old_box_[f].overlaps(old); });
  };
  const auto take_with_plane = [&](std::int32_t other) {
    if (near(fixture, other, box_)) {
      consider(other, [&] { return near(fixture, other, old_box_); });
    }
  };
  if (entries_[f].kind == Kind::kPlane) {
    for (std::size_t g = 0; g < entries_.size(); ++g) {
      const auto other = static_cast<std::int32_t>(g);
      if (entries_[g].kind == Kind::kBox) take_with_plane(other);
    }
    return;
  }
  if (entries_[f].kind == Kind::kNone) return;
  movable_.query(box_[f], take);
  if (entries_[f].proxy.motion != Motion::kDynamic) return;
  ground_.query(box_[f], take);
  for (const std::int32_t plane : planes_) take_with_plane(plane);
}

void BroadPhase::find_begun(int threads) {
  const auto n = static_cast<std::int64_t>(changed_.size());
  found_.resize(usize((n + kQueried - 1) / kQueried));
  parallel_for(
      n, kQueried,
      [&](std::int64_t begin, std::int64_t end) {
        auto& found = found_[usize(begin / kQueried)];
        found.clear();
        for (std::int64_t k = begin; k < end; ++k) {
          find_new(changed_[usize(k)], found);
        }
      },
      threads);
  for (const auto& found : found_) begun_.insert(begun_.end(), found.begin(), found.end());
  std::sort(begun_.begin(), begun_.end(), precedes);
  for (FixturePair& pair : begun_) {
    if (free_slots_.empty()) {
      pair.slot = slots_++;
    } else {
      pair.slot = free_slots_.back();
      free_slots_.pop_back();
    }
  }
}

// Takes out the pairs that ended and puts in those that began and are awake, or not.
void BroadPhase::apply(std::vector<FixturePair>& pairs, bool awake) {
  merged_.clear();
  auto begun = begun_.begin();
  const auto insert = [&](const FixturePair& pair) {
    const bool is_awake = entries_[usize(pair.a)].awake || entries_[usize(pair.b)].awake;
    if (is_awake == awake) merged_.push_back(pair);
  };
  for (const FixturePair& pair : pairs) {
    const int change = change_[usize(pair.a)] | change_[usize(pair.b)];
    if (change != kSame && ((change & kReplaced) != 0 || !near(pair.a, pair.b, box_))) {
      ended_.push_back(pair);
      continue;
    }
    for (; begun != begun_.end() && precedes(*begun, pair); ++begun) insert(*begun);
    merged_.push_back(pair);
  }
  for (; begun != begun_.end(); ++begun) insert(*begun);
  pairs.swap(merged_);
}

void BroadPhase::sort_by_sleep() {
  merged_.resize(awake_.size() + asleep_.size());
  std::merge(awake_.begin(), awake_.end(), asleep_.begin(), asleep_.end(), merged_.begin(),
             precedes);
  awake_.clear();
  asleep_.clear();
  for (const FixturePair& pair : merged_) {
    const bool awake = entries_[usize(pair.a)].awake || entries_[usize(pair.b)].awake;
    (awake ? awake_ : asleep_).push_back(pair);
  }
  sleep_changed_ = false;
}

void BroadPhase::recycle(const std::vector<FixturePair>& pairs) {
  for (auto pair = pairs.rbegin(); pair != pairs.rend(); ++pair) free_slots_.push_back(pair->slot);
}

void BroadPhase::renumber(std::span<const std::int32_t> fixtures,
                          std::span<const std::int32_t> bodies) {
  std::int32_t count = 0;  // of fixture numbers
  for (std::size_t f = 0; f < fixtures.size(); ++f) {
    if (fixtures[f] >= 0 && fixtures[f] < count) throw InputError("numbers must ascend");
    count = std::max(count, fixtures[f] + 1);
  }
  const auto number = [&](std::int32_t f) {
    return usize(f) < fixtures.size() ? fixtures[usize(f)] : -1;
  };
  for (std::size_t f = 0; f < entries_.size(); ++f) {
    if (entries_[f].kind != Kind::kNone && number(static_cast<std::int32_t>(f)) < 0) {
      throw InputError("a fixture without a new number must have been removed");
    }
  }
  const auto body = [&](std::int32_t b) { return b < 0 ? b : bodies[usize(b)]; };

  std::vector<Entry> entries(usize(count));
  std::vector<TreeBox> box(entries.size(), empty_tree_box()), old_box = box;
  std::vector<std::uint8_t> change(entries.size(), kSame);
  for (std::size_t f = 0; f < entries_.size(); ++f) {
    if (entries_[f].kind == Kind::kNone) continue;
    const auto to = usize(fixtures[f]);
    entries[to] = entries_[f];
    entries[to].proxy.body = body(entries_[f].proxy.body);
    box[to] = box_[f];
    old_box[to] = old_box_[f];
    change[to] = change_[f];
  }
  ground_.renumber(fixtures);
  movable_.renumber(fixtures);
  recycle(ended_);
  ended_.clear();
  begun_.clear();
  const auto keep = [&](std::vector<FixturePair>& pairs) {
    merged_.clear();
    std::size_t kept = 0;
    for (FixturePair pair : pairs) {
      const bool gone = entries_[usize(pair.a)].kind == Kind::kNone ||
                        entries_[usize(pair.b)].kind == Kind::kNone;
      if (gone) {
        merged_.push_back(pair);
      } else {
        pairs[kept++] = {number(pair.a), number(pair.b), pair.slot};
      }
    }
    pairs.resize(kept);
    recycle(merged_);
  };
  keep(awake_);
  keep(asleep_);
  const auto keep_numbers = [&](std::vector<std::int32_t>& list) {
    std::erase_if(list, [&](std::int32_t f) { return entries_[usize(f)].kind == Kind::kNone; });
    for (std::int32_t& f : list) f = number(f);
  };
  keep_numbers(planes_);
  keep_numbers(changed_);
  std::vector<std::uint64_t> excluded;
  for (const std::uint64_t k : excluded_) {
    const auto old_a = static_cast<std::int32_t>(k >> 32);
    const auto old_b = static_cast<std::int32_t>(static_cast<std::uint32_t>(k));
    const std::int32_t a = body(old_a), b = body(old_b);
    if ((old_a < 0 || a >= 0) && (old_b < 0 || b >= 0)) excluded.push_back(key(a, b));
  }
  std::sort(excluded.begin(), excluded.end());
  excluded_.swap(excluded);
  entries_.swap(entries);
  box_.swap(box);
  old_box_.swap(old_box);
  change_.swap(change);
}

void BroadPhase::update(std::span<const std::int32_t> moving, std::span<const Bounds> bounds,
                        int threads) {
  find_left(moving, bounds, threads);
  recycle(ended_);
  ended_.clear();
  begun_.clear();
  move_boxes(bounds);
  if (sleep_changed_) sort_by_sleep();
  if (changed_.empty()) return;
  find_begun(threads);
  // An awake fixture that merely moved has no pair that sleeps.
  const bool only_awake = std::all_of(changed_.begin(), changed_.end(), [&](std::int32_t fixture) {
    const auto f = usize(fixture);
    return entries_[f].awake && change_[f] == kMoved;
  });
  apply(awake_, true);
  if (!only_awake) {
    apply(asleep_, false);
    std::sort(ended_.begin(), ended_.end(), precedes);
  }
  for (const std::int32_t fixture : changed_) {
    const auto f = usize(fixture);
    change_[f] = kSame;
    old_box_[f] = box_[f];
  }
  changed_.clear();
}

std::vector<std::int32_t> BroadPhase::overlapping(const Bounds& bounds) const {
  std::vector<std::int32_t> found;
  const TreeBox box = tree_box(bounds);
  const auto take = [&](std::int32_t fixture) { found.push_back(fixture); };
  ground_.query(box, take);
  movable_.query(box, take);
  for (const std::int32_t plane : planes_) {
    const Entry& entry = entries_[usize(plane)];
    if (reaches(box, entry.centre, entry.offset)) take(plane);
  }
  std::sort(found.begin(), found.end());
  return found;
}

std::size_t BroadPhase::bytes() const {
  const auto size = [](const auto& v) { return v.capacity() * sizeof(v[0]); };
  std::size_t sum = ground_.bytes() + movable_.bytes() + size(planes_) + size(entries_) +
                    size(box_) + size(old_box_) + size(change_) + size(changed_) + size(excluded_) +
                    size(awake_) + size(asleep_) + size(begun_) + size(ended_) + size(merged_) +
                    size(free_slots_) + size(left_) + size(found_);
  for (const auto& list : left_) sum += size(list);
  for (const auto& list : found_) sum += size(list);
  return sum;
}

}  // namespace substep::rigid
