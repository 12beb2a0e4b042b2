#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<float, 3>;

}  // namespace substep::mpm
