#include "substep/rigid/world/material_pairs.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "substep/core/errors.h"

namespace substep::rigid {
namespace {

using Names = std::pair<std::string_view, std::string_view>;

Names names(const MaterialPair& pair) { return {pair.a, pair.b}; }

void check(const char* name, const std::optional<double>& value, double least, double most) {
  if (!value || (std::isfinite(*value) && *value >= least && *value <= most)) return;
  throw InputError(std::string(name) + ": expected a finite number from " + std::to_string(least) +
                   (std::isfinite(most) ? " to " + std::to_string(most) : " on") + ", got " +
                   std::to_string(*value));
}

}  // namespace

void MaterialPairs::set(MaterialPair pair) {
  constexpr double kMost = std::numeric_limits<double>::infinity();
  check("friction", pair.friction, 0, kMost);
  if (pair.static_friction && !pair.friction)
    throw InputError("static_friction: expected friction with it");
  check("static_friction", pair.static_friction, pair.friction.value_or(0), kMost);
  check("restitution", pair.restitution, 0, 1);
  check("rolling", pair.rolling, 0, kMost);
  check("spinning", pair.spinning, 0, kMost);
  if (pair.b < pair.a) std::swap(pair.a, pair.b);
  const auto place =
      std::lower_bound(pairs_.begin(), pairs_.end(), names(pair),
                       [](const MaterialPair& p, const Names& q) { return names(p) < q; });
  const bool there = place != pairs_.end() && names(*place) == names(pair);
  if (pair.friction || pair.restitution || pair.rolling || pair.spinning) {
    if (there) {
      *place = std::move(pair);
    } else {
      pairs_.insert(place, std::move(pair));
    }
  } else if (there) {
    pairs_.erase(place);
  }
}

const MaterialPair* MaterialPairs::look_up(std::string_view a, std::string_view b) const {
  const Names wanted = std::minmax(a, b);
  const auto place =
      std::lower_bound(pairs_.begin(), pairs_.end(), wanted,
                       [](const MaterialPair& p, const Names& q) { return names(p) < q; });
  return place != pairs_.end() && names(*place) == wanted ? &*place : nullptr;
}

}  // namespace substep::rigid
