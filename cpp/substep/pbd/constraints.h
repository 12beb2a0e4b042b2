// The list of constraints whose formulas run over lanes: function(name, constraint) for each. The
// binding and the shared tests read it.
#pragma once

#include "substep/pbd/attachment.h"
#include "substep/pbd/dihedral_bending.h"
#include "substep/pbd/isometric_bending.h"
#include "substep/pbd/neo_hookean.h"
#include "substep/pbd/tether.h"
#include "substep/pbd/tetrahedron_volume.h"
#include "substep/pbd/triangle_area.h"

namespace substep::pbd {

template <class... Constraints>
struct ConstraintList {};

using AllConstraints =
    ConstraintList<DihedralBending, IsometricBending, TriangleArea, TetrahedronVolume, Tether,
                   Attachment, NeoHookeanDeviatoric, NeoHookeanHydrostatic>;

}  // namespace substep::pbd
