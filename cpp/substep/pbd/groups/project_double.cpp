#include "substep/pbd/constraints/constraint_list.h"
#include "substep/pbd/groups/project.h"

namespace substep::pbd {

template <>
Kernels<double> find_kernels(std::string_view name) {
  Kernels<double> kernels;
  find_constraint(name, AllConstraints{}, [&]<class Constraint>(Constraint) {
    kernels = Projection<Constraint, double>::kernels();
  });
  return kernels;
}

}  // namespace substep::pbd
