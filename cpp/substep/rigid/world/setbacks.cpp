#include "substep/rigid/world/setbacks.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace substep::rigid {

// Whether any body is set back so far that others may meet it.
bool Setbacks::begin(std::span<const Found> found, const Fixtures& fixtures,
                     std::span<const Way> ways) {
  queue_.clear();
  if (std::all_of(found.begin(), found.end(), [](const Found& of) { return of.stops.empty(); }))
    return false;
  bodies_.assign(ways.size(), Body());
  pushes_.clear(), near_.clear();
  double longest = 0;
  for (const Found& of : found) {
    for (const Stop& stop : of.stops) {
      set(stop.body, stop.back);
      longest = std::max(longest, stop.back.norm());
    }
  }
  // None becomes longer, so that two differ by at most twice that.
  for (const Found& of : found)
    std::copy_if(of.near.begin(), of.near.end(), std::back_inserter(near_),
                 [&](const Near& near) { return near.least <= 2 * longest; });
  if (near_.empty()) return false;
  for (const Found& of : found) pushes_.insert(pushes_.end(), of.pushes.begin(), of.pushes.end());
  of_body_.assign(static_cast<std::int64_t>(ways.size()), [&](const auto& visit) {
    const auto each = [&](const auto& links, std::size_t first) {
      for (std::size_t k = links.size(); k-- > 0;) {
        visit(links[k].a, static_cast<std::int32_t>(first + k));
        visit(links[k].b, static_cast<std::int32_t>(first + k));
      }
    };
    each(near_, pushes_.size());
    each(pushes_, 0);
  });
  boxes_.resize(usize(fixtures.size()));
  has_box_.assign(usize(fixtures.size()), 0);
  return true;
}

void Setbacks::set(std::int32_t body, const Vec3& back) {
  Body& of = bodies_[usize(body)];
  if (!(back.squaredNorm() > kMore * of.back.squaredNorm())) return;
  of.back = back;
  if (!of.waits) queue_.push_back(body);
  of.waits = true;
}

void Setbacks::pass_on(const Push& push) {
  const auto passed = [&](const Vec3& back) {
    const double by = back.dot(push.normal);
    return std::min(push.bounce * (by - push.gap), by);
  };
  const double of_a = passed(bodies_[usize(push.a)].back),
               of_b = passed(-bodies_[usize(push.b)].back);
  if (of_a > 0) set(push.b, of_a * push.normal);
  if (of_b > 0) set(push.a, -of_b * push.normal);
}

void Setbacks::join(Near& near, const std::optional<Push>& push) {
  if (!push) return;
  near.push = static_cast<std::int32_t>(pushes_.size());
  pushes_.push_back(*push);
}

Setbacks::Approach Setbacks::approach(const Near& near, std::span<const Way> ways) const {
  const Vec3 back = bodies_[usize(near.a)].back - bodies_[usize(near.b)].back,
             way = ways[usize(near.a)].travel - ways[usize(near.b)].travel;
  return {back.norm() + way.norm(), way + back};
}

// Only once for the same setbacks. The box of one is moved as it goes relative to the other.
bool Setbacks::may_meet(Near& near, const FixturePair& pair, const Fixtures& fixtures,
                        std::span<const Way> ways) {
  const Vec3 &back_a = bodies_[usize(near.a)].back, &back_b = bodies_[usize(near.b)].back;
  if (near.least > 0 && !((back_b - back_a).squaredNorm() > near.least * near.least)) return false;
  const double now = back_a.squaredNorm() + back_b.squaredNorm();
  if (std::exchange(near.looked, now) == now) return false;
  const Vec3 way = ways[usize(near.b)].travel - ways[usize(near.a)].travel;
  const Vec3 end = way + back_b - back_a;
  const double margin = std::min(fixtures[pair.a].margin, fixtures[pair.b].margin);
  Bounds moved = box(pair.b, fixtures);
  moved.low += end.cwiseMin(way).cwiseMin(-margin);
  moved.high += end.cwiseMax(way).cwiseMax(margin);
  return !apart(box(pair.a, fixtures), moved);
}

const Bounds& Setbacks::box(std::int32_t fixture, const Fixtures& fixtures) {
  Bounds& box = boxes_[usize(fixture)];
  if (std::exchange(has_box_[usize(fixture)], 1) == 0)
    box = bounds(fixtures[fixture].fixture.shape, fixtures.pose(fixture));
  return box;
}

}  // namespace substep::rigid
