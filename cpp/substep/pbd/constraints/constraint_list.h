// The constraints that are formulas (constraint.h): a new one is a header, its name here, and a
// documented class in Python. The solver and the shared tests read the list.
#pragma once

#include <string>
#include <string_view>

#include "substep/core/errors.h"
#include "substep/pbd/constraints/attachment.h"
#include "substep/pbd/constraints/dihedral_bending.h"
#include "substep/pbd/constraints/distance.h"
#include "substep/pbd/constraints/isometric_bending.h"
#include "substep/pbd/constraints/neo_hookean.h"
#include "substep/pbd/constraints/tether.h"
#include "substep/pbd/constraints/tetrahedron_volume.h"
#include "substep/pbd/constraints/triangle_area.h"

namespace substep::pbd {

template <class... Constraints>
struct ConstraintList {};

using AllConstraints =
    ConstraintList<Distance, DihedralBending, IsometricBending, TriangleArea, TetrahedronVolume,
                   Tether, Attachment, NeoHookeanDeviatoric, NeoHookeanHydrostatic>;

// visit(Constraint{}) for the one of that name.
template <class Visit, class... Constraint>
void find_constraint(std::string_view name, ConstraintList<Constraint...>, Visit&& visit) {
  const bool found = ((name == Constraint::kName && (visit(Constraint{}), true)) || ...);
  if (!found) throw InputError("constraint: unknown name " + std::string(name));
}

}  // namespace substep::pbd
