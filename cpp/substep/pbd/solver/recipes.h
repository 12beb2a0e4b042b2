// Groups of constraints before it is known in which precision: a simulation (body.h) makes its own
// of each.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "substep/geometry/vectors.h"
#include "substep/pbd/groups/clusters.h"
#include "substep/pbd/groups/group.h"
#include "substep/pbd/groups/user_constraints.h"

namespace substep::pbd {

class Recipe {
 public:
  virtual ~Recipe() = default;
  virtual std::unique_ptr<Group<float>> in_single() const = 0;
  virtual std::unique_ptr<Group<double>> in_double() const = 0;
};

// Of a kind of constraint_list.h. stiffness: of plain PBD; empty: XPBD.
std::unique_ptr<Recipe> constraint_recipe(std::string kind, std::vector<std::int32_t> particles,
                                          std::vector<double> parameters,
                                          std::vector<double> compliance,
                                          std::vector<double> damping,
                                          std::vector<double> stiffness);
std::unique_ptr<Recipe> shape_matching_recipe(Clusters clusters);
std::unique_ptr<Recipe> user_recipe(UserConstraints constraints);
std::unique_ptr<Recipe> self_contact_recipe(std::vector<std::array<std::int32_t, 3>> faces,
                                            std::vector<geometry::Vec3> rest, double thickness,
                                            double friction);
// rest: three numbers each.
std::unique_ptr<Recipe> particle_collision_recipe(std::vector<double> radii,
                                                  std::vector<double> rest, double friction);

}  // namespace substep::pbd
