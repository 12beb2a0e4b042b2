// What a contact or a joint acts on.
#pragma once

#include <cstdint>

namespace substep::rigid {

// Two bodies by their number; below 0: one that no impulse moves (static, kinematic, the world).
struct BodyPair {
  std::int32_t a, b;
};

}  // namespace substep::rigid
