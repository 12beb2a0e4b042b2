// Lines that are transformed at once (line_transform.h), their numbers side by side: those of the
// first half are real parts of z, the others imaginary ones.
#pragma once

#include "substep/core/lanes.h"

namespace substep::gridfluid {

using Packet = Vector<double, kVectorBytes>;
inline constexpr int kPacket = kVectorBytes / 8;  // its numbers
inline constexpr int kLines = 2 * kPacket;

}  // namespace substep::gridfluid
