#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/pbf/liquid.h"

namespace {

using namespace substep::pbf;
using substep::geometry::Collider;
using substep::geometry::ParticleFlow;

FluidOptions options(const py::dict& given) {
  FluidOptions o;
  o.density = {.kernel = word(given, "kernel") == "cubic_spline" ? Kernel::kCubicSpline
                                                                 : Kernel::kPoly6Spiky,
               .dimension = integer(given, "dimension"),
               .spacing = number(given, "spacing"),
               .support = number(given, "support"),
               .relaxation = number(given, "relaxation"),
               .artificial_pressure = number(given, "artificial_pressure"),
               .one_sided = flag(given, "one_sided")};
  o.forces.xsph = number(given, "xsph");
  o.forces.viscosity = given["viscosity"].cast<std::vector<double>>();
  o.forces.vorticity_confinement = number(given, "vorticity_confinement");
  o.forces.surface_tension = number(given, "surface_tension");
  o.masses = given["masses"].cast<std::vector<double>>();
  o.gravity = vector(given, "gravity");
  o.tolerance = number(given, "tolerance");
  o.max_tolerance = number(given, "max_tolerance");
  o.min_iterations = integer(given, "min_iterations");
  o.max_iterations = integer(given, "max_iterations");
  o.divergence_free = flag(given, "divergence_free");
  o.divergence_tolerance = number(given, "divergence_tolerance");
  o.divergence_iterations = integer(given, "divergence_iterations");
  o.warm_start = number(given, "warm_start");
  const std::string escape = word(given, "on_escape");
  o.on_escape = escape == "raise"    ? OnEscape::kRaise
                : escape == "remove" ? OnEscape::kRemove
                                     : OnEscape::kClamp;
  if (!given["bounds"].is_none()) {
    const auto bounds = given["bounds"].cast<std::array<Triple, 2>>();
    o.bounds = {vector(bounds[0]), vector(bounds[1])};
  }
  return o;
}

auto rows_of(std::vector<double> (Liquid::*get)() const) {
  return [get](const Liquid& self) { return table((self.*get)(), self.dimension()); };
}
auto set_rows(void (Liquid::*set)(std::span<const Vec3>, Liquid::Places)) {
  return [set](Liquid& self, const Reals& values, const Array<std::int64_t>& places) {
    (self.*set)(Points(values), rows_in(places, self.size()));
  };
}

py::dict state(const Liquid& self) {
  const LiquidState s = self.state();
  py::dict out;
  out["time"] = s.time;
  out["last_dt"] = s.last_dt;
  out["next_id"] = s.next_id;
  out["positions"] = rows(s.positions, 4);
  out["velocities"] = rows(s.velocities, 4);
  out["forces"] = rows(s.forces, 4);
  out["ids"] = column(s.ids);
  out["fluids"] = column(s.fluids);
  return out;
}

void restore(Liquid& self, double time, double last_dt, std::int64_t next_id,
             const py::array& positions, const py::array& velocities, const py::array& forces,
             const LongIndices& ids, const Indices& fluids, const LongIndices& layers,
             const LongIndices& absorbed) {
  self.restore({.time = time,
                .last_dt = last_dt,
                .next_id = next_id,
                .positions = numbers(positions),
                .velocities = numbers(velocities),
                .forces = numbers(forces),
                .ids = list(ids),
                .fluids = list(fluids),
                .flow = {.layers = list(layers), .absorbed = list(absorbed)}});
}

void bind_reports(py::module_& m) {
  py::class_<FluidReport>(m, "FluidReport")
      .def_readonly("iterations", &FluidReport::iterations)
      .def_readonly("converged", &FluidReport::converged)
      .def_readonly("limited", &FluidReport::limited)
      .def_property_readonly("viscosity_iterations",
                             [](const FluidReport& r) { return r.viscosity.iterations; })
      .def_property_readonly("viscosity_converged",
                             [](const FluidReport& r) { return r.viscosity.converged; })
      .def_property_readonly("divergence_iterations",
                             [](const FluidReport& r) { return r.projection.iterations; })
      .def_property_readonly("divergence_error",
                             [](const FluidReport& r) { return r.projection.error; })
      .def_property_readonly("divergence_converged",
                             [](const FluidReport& r) { return r.projection.converged; })
      .def_readonly("removed", &FluidReport::removed)
      .def_readonly("clamped", &FluidReport::clamped)
      .def_property_readonly("mean_error",
                             [](const FluidReport& r) { return r.density_error.mean; })
      .def_property_readonly("max_error", [](const FluidReport& r) { return r.density_error.max; });
  py::class_<Energies>(m, "FluidEnergies")
      .def_readonly("kinetic", &Energies::kinetic)
      .def_readonly("potential", &Energies::potential)
      .def_property_readonly("momentum", [](const Energies& e) { return triple(e.momentum); })
      .def_property_readonly("angular_momentum",
                             [](const Energies& e) { return triple(e.angular_momentum); });
}

}  // namespace

void bind_pbf(py::module_& m) {
  bind_reports(m);
  py::class_<Liquid, substep::Simulation>(m, "PositionBasedFluid")
      .def(py::init([](const Triple& origin, std::vector<std::shared_ptr<Collider>> colliders,
                       const ParticleFlow& flow, const py::dict& given, const std::string& dtype) {
             return make_liquid(precision(dtype), vector(origin), std::move(colliders),
                                options(given), flow);
           }),
           py::arg("origin"), py::arg("colliders"), py::arg("flow"), py::arg("options"),
           py::arg("dtype"))
      .def(
          "add",
          [](Liquid& self, const Reals& positions, const Reals& velocities,
             const Array<std::int32_t>& fluids) {
            return self.add(Points(positions), Points(velocities), readable(fluids));
          },
          py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
          py::arg("fluids").noconvert())
      .def(
          "remove",
          [](Liquid& self, const Array<std::int64_t>& places) {
            self.remove(rows_in(places, self.size()));
          },
          py::arg("places").noconvert())
      .def("step", &Liquid::step, py::arg("dt"), py::call_guard<py::gil_scoped_release>())
      .def("__len__", &Liquid::size)
      .def_property("time", &Liquid::time, &Liquid::set_time)
      .def_property("threads", &Liquid::threads, &Liquid::set_threads)
      .def_property_readonly("report", &Liquid::report)
      .def_property_readonly("energies", &Liquid::energies)
      .def_property_readonly("fastest", &Liquid::fastest)
      .def_property_readonly("lone_density", &Liquid::lone_density)
      .def_property_readonly("layers",
                             [](const Liquid& self) { return column(self.counts().layers); })
      .def_property_readonly("absorbed",
                             [](const Liquid& self) { return column(self.counts().absorbed); })
      .def("ids", [](const Liquid& self) { return column(self.ids()); })
      .def("fluids", [](const Liquid& self) { return column(self.fluids()); })
      .def("densities",
           [](Liquid& self) {
             std::vector<double> values;
             {
               const py::gil_scoped_release released;
               values = self.densities();
             }
             return column(values);
           })
      .def("positions", rows_of(&Liquid::positions))
      .def("velocities", rows_of(&Liquid::velocities))
      .def("set_positions", set_rows(&Liquid::set_positions), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("set_velocities", set_rows(&Liquid::set_velocities), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("set_forces", set_rows(&Liquid::set_forces), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("state", &state)
      .def("restore", &restore, py::arg("time"), py::arg("last_dt"), py::arg("next_id"),
           py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
           py::arg("forces").noconvert(), py::arg("ids").noconvert(), py::arg("fluids").noconvert(),
           py::arg("layers").noconvert(), py::arg("absorbed").noconvert());
}
