#include "substep/pbf/forces.h"

#include "substep/core/usize.h"
#include "substep/pbf/xsph.h"

namespace substep::pbf {

template <class Real>
void Forces<Real>::pull_together(const ForceOptions& options, const Rows& rows,
                                 double reference_mass, double factor,
                                 std::span<const Point<Real>> x, std::span<Point<Real>> moved) {
  if (!(options.surface_tension > 0)) return;
  other_.assign(x.begin(), x.end());
  surface_tension_.displace(
      {other_, {}, rows.lists, rows.h, rows.volume, rows.dimension, rows.threads},
      options.surface_tension, reference_mass, static_cast<Real>(factor), moved);
}

template <class Real>
ViscosityReport Forces<Real>::act_on_velocities(const ForceOptions& options, const Rows& rows,
                                                std::span<const Point<Real>> x, double dt,
                                                std::vector<Point<Real>>& v) {
  ViscosityReport report;
  const auto near = [&] {
    return Neighbourhood<Real>{x, v, rows.lists, rows.h, rows.volume, rows.dimension, rows.threads};
  };
  other_.resize(v.size());
  if (!options.viscosity.empty()) {
    nu_.resize(rows.fluid.size());
    for (std::size_t i = 0; i < nu_.size(); ++i) {
      nu_[i] = static_cast<Real>(options.viscosity[usize(rows.fluid[i])]);
    }
    report = viscosity_.solve(near(), nu_, static_cast<Real>(dt),
                              static_cast<Real>(options.viscosity_tolerance),
                              options.viscosity_iterations, other_);
    v.swap(other_);
  }
  if (options.xsph > 0) {
    xsph<Real>(near(), static_cast<Real>(options.xsph), other_);
    v.swap(other_);
  }
  if (options.vorticity_confinement > 0) {
    confinement_.apply(near(), static_cast<Real>(options.vorticity_confinement),
                       static_cast<Real>(dt), v);
  }
  return report;
}

template class Forces<float>;
template class Forces<double>;

}  // namespace substep::pbf
