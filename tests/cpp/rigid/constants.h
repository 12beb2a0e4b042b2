// Numbers that many tests share.
#pragma once

#include <numbers>

namespace substep::rigid {

inline constexpr double kPi = std::numbers::pi;
inline constexpr double g = 9.81;  // [m/s^2]

}  // namespace substep::rigid
