// Numbers of either precision, for interfaces that are no templates.
#pragma once

#include <span>
#include <variant>
#include <vector>

namespace substep {

enum class Precision { kSingle, kDouble };

using Numbers = std::variant<std::vector<float>, std::vector<double>>;
// Of others.
using NumbersIn = std::variant<std::span<const float>, std::span<const double>>;
using NumbersOut = std::variant<std::span<float>, std::span<double>>;

}  // namespace substep
