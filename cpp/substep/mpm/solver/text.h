// Numbers in the messages of errors.
#pragma once

#include <cstdio>
#include <string>

namespace substep::mpm {

inline std::string text(const char* format, double a, double b = 0) {
  char buffer[160];
  std::snprintf(buffer, sizeof buffer, format, a, b);
  return buffer;
}

}  // namespace substep::mpm
