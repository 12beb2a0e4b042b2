#include "substep/geometry/particle_flow.h"

#include <pybind11/stl.h>

#include "arrays.h"

namespace {

using substep::geometry::Collider;
using substep::geometry::Emitter;
using substep::geometry::ParticleFlow;

Emitter emitter(const py::dict& given) {
  return {.position = vector(given, "position"),
          .direction = vector(given, "direction"),
          .speed = number(given, "speed"),
          .offsets = Points(given["offsets"].cast<Reals>()).copied(),
          .thickness = number(given, "thickness"),
          .volume = number(given, "volume"),
          .kind = integer(given, "kind"),
          .start = number(given, "start"),
          .stop = number(given, "stop")};
}

}  // namespace

void bind_particle_flow(py::module_& m) {
  py::class_<ParticleFlow>(m, "ParticleFlow")
      .def(py::init([](const std::vector<py::dict>& emitters,
                       const std::vector<std::shared_ptr<Collider>>& sinks) {
             std::vector<Emitter> taps;
             for (const py::dict& given : emitters) taps.push_back(emitter(given));
             return ParticleFlow(std::move(taps), {sinks.begin(), sinks.end()});
           }),
           py::arg("emitters"), py::arg("sinks"));
}
