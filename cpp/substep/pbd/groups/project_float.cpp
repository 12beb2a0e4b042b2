#include "substep/pbd/constraints/constraint_list.h"
#include "substep/pbd/groups/project.h"

namespace substep::pbd {

template <>
Kernels<float> find_kernels(std::string_view name) {
  Kernels<float> kernels;
  find_constraint(name, AllConstraints{}, [&]<class Constraint>(Constraint) {
    kernels = Projection<Constraint, float>::kernels();
  });
  return kernels;
}

}  // namespace substep::pbd
