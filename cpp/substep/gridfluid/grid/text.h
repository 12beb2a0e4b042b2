#pragma once

#include <array>
#include <cstdio>
#include <string>

namespace substep::gridfluid {

// Of a number in a message, however large or small it is.
inline std::string text(double x) {
  std::array<char, 32> buffer{};
  std::snprintf(buffer.data(), buffer.size(), "%.6g", x);
  return buffer.data();
}

}  // namespace substep::gridfluid
