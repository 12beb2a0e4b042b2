// Groups of the constraints of constraint_list.h, by name.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "substep/pbd/groups/group.h"

namespace substep::pbd {

struct ConstraintKind {
  std::string name;
  int points, parameters;
  bool inequality;
};
const std::vector<ConstraintKind>& constraint_kinds();

// particles and parameters: those of each constraint, one behind the other.
template <class Real>
std::unique_ptr<Group<Real>> make_group(const std::string& name,
                                        std::vector<std::int32_t> particles,
                                        std::vector<double> parameters, const Softness& softness);

// C and gradients (points * 3 each) of `count` constraints at x (count * points * 3), for tests.
void evaluate_constraints(const std::string& name, std::size_t count, const double* x,
                          const double* parameters, double* c, double* gradient);

}  // namespace substep::pbd
