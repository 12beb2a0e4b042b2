// How groups of constraints pass through Python: made by a class of constraints, cloned by the
// simulation that they are given to. Other kinds of groups bind factories that return this handle.
#pragma once

#include <memory>

#include "substep/pbd/groups/group.h"

template <class Real>
struct GroupHandle {
  std::unique_ptr<substep::pbd::Group<Real>> group;
};
