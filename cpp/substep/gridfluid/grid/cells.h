// What stands in the cells of a grid.
#pragma once

#include <cstdint>

namespace substep::gridfluid {

enum class Cell : std::uint8_t {
  kFluid,  // has a pressure
  kAir,    // pressure 0 at the surface between
  kSolid,  // no pressure, and no open face
};

}  // namespace substep::gridfluid
