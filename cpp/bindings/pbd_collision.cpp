#include "bindings.h"
#include "pbd_groups.h"
#include "substep/pbd/contact/particle_collision.h"
#include "substep/pbd/contact/self_contact.h"

namespace {

using namespace substep::pbd;

using Reals = py::array_t<double, py::array::c_style>;
using Indices = py::array_t<std::int32_t, py::array::c_style>;

template <class Real>
GroupHandle<Real> self_collision(const Indices& faces, const Reals& rest, double thickness,
                                 double friction) {
  std::vector<std::array<std::int32_t, 3>> triangles;
  for (py::ssize_t k = 0; k < faces.shape(0); ++k) {
    triangles.push_back({faces.at(k, 0), faces.at(k, 1), faces.at(k, 2)});
  }
  std::vector<substep::geometry::Vec3> x;
  for (py::ssize_t k = 0; k < rest.shape(0); ++k) {
    x.emplace_back(rest.at(k, 0), rest.at(k, 1), rest.at(k, 2));
  }
  const SelfContactOptions options{.thickness = thickness, .friction = friction};
  return {std::make_unique<SelfContact<Real>>(std::move(triangles), std::move(x), options)};
}

template <class Real>
GroupHandle<Real> particle_collision(const Reals& radii, const Reals& rest, double friction) {
  return {std::make_unique<ParticleCollision<Real>>(
      std::vector(radii.data(), radii.data() + radii.size()),
      std::vector(rest.data(), rest.data() + rest.size()), friction)};
}

template <class Real>
void bind(py::module_& m, const char* self_name, const char* particle_name) {
  m.def(self_name, &self_collision<Real>, py::arg("faces").noconvert(), py::arg("rest").noconvert(),
        py::arg("thickness"), py::arg("friction"));
  m.def(particle_name, &particle_collision<Real>, py::arg("radii").noconvert(),
        py::arg("rest").noconvert(), py::arg("friction"));
}

}  // namespace

void bind_pbd_collision(py::module_& m) {
  bind<float>(m, "self_collision32", "particle_collision32");
  bind<double>(m, "self_collision64", "particle_collision64");
}
