#include "substep/pbd/solver/recipes.h"

#include <utility>

#include "substep/pbd/contact/particle_collision.h"
#include "substep/pbd/contact/self_contact.h"
#include "substep/pbd/groups/constraints.h"
#include "substep/pbd/groups/shape_matching.h"

namespace substep::pbd {
namespace {

template <class Make>
class RecipeOf final : public Recipe {
 public:
  explicit RecipeOf(Make make) : make_(std::move(make)) {}
  std::unique_ptr<Group<float>> in_single() const override { return make_(float{}); }
  std::unique_ptr<Group<double>> in_double() const override { return make_(double{}); }

 private:
  Make make_;
};

// make(Real{}) gives a group.
template <class Make>
std::unique_ptr<Recipe> recipe(Make make) {
  return std::make_unique<RecipeOf<Make>>(std::move(make));
}

}  // namespace

std::unique_ptr<Recipe> constraint_recipe(std::string kind, std::vector<std::int32_t> particles,
                                          std::vector<double> parameters,
                                          std::vector<double> compliance,
                                          std::vector<double> damping,
                                          std::vector<double> stiffness) {
  Softness softness;
  softness.physical = stiffness.empty();
  softness.compliance = std::move(compliance);
  softness.damping = std::move(damping);
  softness.stiffness = std::move(stiffness);
  return recipe([kind = std::move(kind), particles = std::move(particles),
                 parameters = std::move(parameters), softness = std::move(softness)]<class Real>(
                    Real) { return make_group<Real>(kind, particles, parameters, softness); });
}

std::unique_ptr<Recipe> shape_matching_recipe(Clusters clusters) {
  return recipe([clusters = std::move(clusters)]<class Real>(Real) {
    return std::make_unique<ShapeMatching<Real>>(clusters);
  });
}

std::unique_ptr<Recipe> user_recipe(UserConstraints constraints) {
  return recipe([constraints = std::move(constraints)]<class Real>(Real) {
    return std::make_unique<UserGroup<Real>>(constraints);
  });
}

std::unique_ptr<Recipe> self_contact_recipe(std::vector<std::array<std::int32_t, 3>> faces,
                                            std::vector<geometry::Vec3> rest, double thickness,
                                            double friction) {
  const SelfContactOptions options{.thickness = thickness, .friction = friction};
  return recipe([faces = std::move(faces), rest = std::move(rest), options]<class Real>(Real) {
    return std::make_unique<SelfContact<Real>>(faces, rest, options);
  });
}

std::unique_ptr<Recipe> particle_collision_recipe(std::vector<double> radii,
                                                  std::vector<double> rest, double friction) {
  return recipe([radii = std::move(radii), rest = std::move(rest), friction]<class Real>(Real) {
    return std::make_unique<ParticleCollision<Real>>(radii, rest, friction);
  });
}

}  // namespace substep::pbd
