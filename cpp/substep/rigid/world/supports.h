// Which bodies may be held by what pushes and cannot pull.
#pragma once

#include <cstdint>
#include <vector>

#include "substep/rigid/world/world.h"

namespace substep::rigid {

// Of each body, 1: in the last step a contact pressed it, or a taut rope or the end of a joint held
// it, or it hangs together with one of these by joints that have no springs.
std::vector<std::uint8_t> supported_bodies(const World& world);

}  // namespace substep::rigid
