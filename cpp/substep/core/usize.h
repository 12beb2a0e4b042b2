// Numbers are signed here; sizes and subscripts of the standard library are not.
#pragma once

#include <cstddef>

namespace substep {

template <class T>
[[gnu::always_inline]] constexpr std::size_t usize(T n) {
  return static_cast<std::size_t>(n);
}

}  // namespace substep
