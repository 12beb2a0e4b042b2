// Asks for an object that is needed soon, all of it, where the hardware does not see what comes
// next.
#pragma once

#include <cstddef>

namespace substep {

template <class T>
[[gnu::always_inline]] inline void prefetch(const T& object) {
  constexpr std::size_t kLine = 64;
  const auto* const first = reinterpret_cast<const char*>(&object);
  for (std::size_t at = 0; at < sizeof(T); at += kLine) __builtin_prefetch(first + at);
}

}  // namespace substep
