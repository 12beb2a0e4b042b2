#include "substep/mpm/materials/snow.h"

#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<Snow, float, 2>;
template struct Passes<Snow, float, 3>;
template struct Passes<Snow, double, 2>;
template struct Passes<Snow, double, 3>;

}  // namespace substep::mpm
