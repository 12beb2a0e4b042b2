#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/gridfluid/liquid.h"

namespace {

using namespace substep::gridfluid;
using substep::geometry::Collider;
using substep::geometry::ParticleFlow;

LiquidOptions options(const py::dict& given) {
  LiquidOptions o;
  o.dimension = integer(given, "dimension");
  o.cells = given["cells"].cast<std::array<int, 3>>();
  o.low = vector(given, "low");
  o.cell = number(given, "cell");
  o.open = given["open"].cast<std::array<std::array<bool, 2>, 3>>();
  o.periodic = given["periodic"].cast<std::array<bool, 3>>();
  o.density = number(given, "density");
  o.gravity = vector(given, "gravity");
  const std::string transfer = word(given, "transfer");
  o.transfer = transfer == "pic"    ? Transfer::kPic
               : transfer == "flip" ? Transfer::kFlip
                                    : Transfer::kApic;
  o.flip_rate = number(given, "flip_rate");
  o.tolerance = number(given, "tolerance");
  o.max_iterations = integer(given, "max_iterations");
  o.keep_volume = flag(given, "keep_volume");
  return o;
}

auto rows_of(std::vector<double> (Liquid::*get)() const) {
  return [get](const Liquid& self) { return table((self.*get)(), self.dimension()); };
}
auto set_rows(void (Liquid::*set)(std::span<const Vec3>, Liquid::Places)) {
  return [set](Liquid& self, const Reals& values, const LongIndices& places) {
    (self.*set)(Points(values), rows_in(places, self.size()));
  };
}
// Numbers that take a while to find.
auto found(std::vector<double> (Liquid::*get)()) {
  return [get](Liquid& self) {
    std::vector<double> values;
    {
      const py::gil_scoped_release released;
      values = (self.*get)();
    }
    return column(values);
  };
}

py::dict state(const Liquid& self) {
  const LiquidState s = self.state();
  const int d = self.dimension();
  py::dict out;
  out["time"] = s.time;
  out["last_dt"] = s.last_dt;
  out["next_id"] = s.next_id;
  out["positions"] = rows(s.positions, d);
  out["velocities"] = rows(s.velocities, d);
  out["affine"] = rows(s.affine, d * d);
  out["forces"] = rows(s.forces, d);
  out["ids"] = column(s.ids);
  out["pressure"] = column(s.pressure);
  return out;
}

void restore(Liquid& self, double time, double last_dt, std::int64_t next_id,
             const py::array& positions, const py::array& velocities, const py::array& affine,
             const py::array& forces, const LongIndices& ids, const Reals& pressure,
             const LongIndices& layers, const LongIndices& absorbed) {
  self.restore({.time = time,
                .last_dt = last_dt,
                .next_id = next_id,
                .positions = numbers(positions),
                .velocities = numbers(velocities),
                .affine = numbers(affine),
                .forces = numbers(forces),
                .ids = list(ids),
                .pressure = list(pressure),
                .flow = {.layers = list(layers), .absorbed = list(absorbed)}});
}

void bind_reports(py::module_& m) {
  py::class_<LiquidReport>(m, "LiquidReport")
      .def_readonly("iterations", &LiquidReport::iterations)
      .def_readonly("residual", &LiquidReport::residual)
      .def_readonly("converged", &LiquidReport::converged)
      .def_readonly("volume_iterations", &LiquidReport::volume_iterations)
      .def_readonly("mean_error", &LiquidReport::mean_error)
      .def_readonly("removed", &LiquidReport::removed);
  py::class_<LiquidEnergies>(m, "LiquidEnergies")
      .def_readonly("kinetic", &LiquidEnergies::kinetic)
      .def_readonly("potential", &LiquidEnergies::potential)
      .def_property_readonly("momentum", [](const LiquidEnergies& e) { return triple(e.momentum); })
      .def_property_readonly("angular_momentum",
                             [](const LiquidEnergies& e) { return triple(e.angular_momentum); });
}

}  // namespace

void bind_grid_liquid(py::module_& m) {
  bind_reports(m);
  py::class_<Liquid>(m, "GridLiquid")
      .def(py::init([](std::vector<std::shared_ptr<Collider>> colliders, const ParticleFlow& flow,
                       const py::dict& given, const std::string& dtype) {
             return make_liquid(precision(dtype), std::move(colliders), options(given), flow);
           }),
           py::arg("colliders"), py::arg("flow"), py::arg("options"), py::arg("dtype"))
      .def(
          "add",
          [](Liquid& self, const Reals& positions, const Reals& velocities) {
            return self.add(Points(positions), Points(velocities));
          },
          py::arg("positions").noconvert(), py::arg("velocities").noconvert())
      .def(
          "remove",
          [](Liquid& self, const LongIndices& places) {
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
      .def_property_readonly("layers",
                             [](const Liquid& self) { return column(self.counts().layers); })
      .def_property_readonly("absorbed",
                             [](const Liquid& self) { return column(self.counts().absorbed); })
      .def("ids", [](const Liquid& self) { return column(self.ids()); })
      .def("positions", rows_of(&Liquid::positions))
      .def("velocities", rows_of(&Liquid::velocities))
      .def("pressure", [](const Liquid& self) { return column(self.pressure()); })
      .def("level_set", found(&Liquid::level_set))
      .def("grid_velocity", found(&Liquid::grid_velocity))
      .def("set_positions", set_rows(&Liquid::set_positions), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("set_velocities", set_rows(&Liquid::set_velocities), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("set_forces", set_rows(&Liquid::set_forces), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("state", &state)
      .def("restore", &restore, py::arg("time"), py::arg("last_dt"), py::arg("next_id"),
           py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
           py::arg("affine").noconvert(), py::arg("forces").noconvert(),
           py::arg("ids").noconvert(), py::arg("pressure").noconvert(),
           py::arg("layers").noconvert(), py::arg("absorbed").noconvert());
}
