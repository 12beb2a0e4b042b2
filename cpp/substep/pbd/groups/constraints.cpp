#include "substep/pbd/groups/constraints.h"

#include "substep/pbd/constraints/constraint_list.h"
#include "substep/pbd/constraints/lanes3.h"
#include "substep/pbd/groups/constraint_group.h"

namespace substep::pbd {
namespace {

template <class... Constraint>
std::vector<ConstraintKind> kinds(ConstraintList<Constraint...>) {
  return {{Constraint::kName, Constraint::kPoints, Constraint::kParameters,
           Constraint::kInequality}...};
}

}  // namespace

const std::vector<ConstraintKind>& constraint_kinds() {
  static const std::vector<ConstraintKind> all = kinds(AllConstraints{});
  return all;
}

template <class Real>
std::unique_ptr<Group<Real>> make_group(const std::string& name,
                                        std::vector<std::int32_t> particles,
                                        std::vector<double> parameters, const Softness& softness) {
  return std::make_unique<ConstraintGroup<Real>>(find_kernels<Real>(name), std::move(particles),
                                                 std::move(parameters), softness);
}

void evaluate_constraints(const std::string& name, std::size_t count, const double* x,
                          const double* parameters, double* c, double* gradient) {
  find_constraint(name, AllConstraints{}, [&]<class Constraint>(Constraint) {
    using V = Vector<double, 16>;
    constexpr std::size_t kPoints = Constraint::kPoints, kParameters = Constraint::kParameters;
    for (std::size_t j = 0; j < count; ++j) {
      std::array<Lanes3<V>, kPoints> at, g;
      for (std::size_t i = 0; i < kPoints; ++i) {
        const double* p = x + 3 * (kPoints * j + i);
        at[i] = {splat<V>(p[0]), splat<V>(p[1]), splat<V>(p[2])};
      }
      std::array<V, kParameters> own;
      for (std::size_t i = 0; i < kParameters; ++i) {
        own[i] = splat<V>(parameters[kParameters * j + i]);
      }
      V value;
      Constraint::template evaluate<V>(at, own, value, g);
      c[j] = value[0];
      for (std::size_t i = 0; i < kPoints; ++i) {
        double* out = gradient + 3 * (kPoints * j + i);
        out[0] = g[i].x[0], out[1] = g[i].y[0], out[2] = g[i].z[0];
      }
    }
  });
}

template std::unique_ptr<Group<float>> make_group(const std::string&, std::vector<std::int32_t>,
                                                  std::vector<double>, const Softness&);
template std::unique_ptr<Group<double>> make_group(const std::string&, std::vector<std::int32_t>,
                                                   std::vector<double>, const Softness&);

}  // namespace substep::pbd
