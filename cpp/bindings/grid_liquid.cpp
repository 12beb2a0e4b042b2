#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/gridfluid/liquid/liquid.h"

namespace {

namespace gridfluid = substep::gridfluid;
using GridLiquid = gridfluid::Liquid;

gridfluid::LiquidOptions grid_liquid_options(const py::dict& given) {
  gridfluid::LiquidOptions o;
  o.dimension = integer(given, "dimension");
  o.cells = given["cells"].cast<std::array<int, 3>>();
  o.low = vector(given, "low");
  o.cell = number(given, "cell");
  o.open = given["open"].cast<std::array<std::array<bool, 2>, 3>>();
  o.periodic = given["periodic"].cast<std::array<bool, 3>>();
  o.density = number(given, "density");
  o.gravity = vector(given, "gravity");
  const std::string transfer = word(given, "transfer");
  o.transfer = transfer == "pic"    ? gridfluid::Transfer::kPic
               : transfer == "flip" ? gridfluid::Transfer::kFlip
                                    : gridfluid::Transfer::kApic;
  o.flip_rate = number(given, "flip_rate");
  o.viscosity = number(given, "viscosity");
  o.surface_tension = number(given, "surface_tension");
  o.slip = flag(given, "slip");
  o.tolerance = number(given, "tolerance");
  o.max_iterations = integer(given, "max_iterations");
  o.keep_volume = flag(given, "keep_volume");
  o.narrow_band = integer(given, "narrow_band");
  return o;
}

auto rows_of_liquid(std::vector<double> (GridLiquid::*get)() const) {
  return [get](const GridLiquid& self) { return table((self.*get)(), self.dimension()); };
}
auto set_liquid_rows(void (GridLiquid::*set)(std::span<const substep::geometry::Vec3>,
                                             GridLiquid::Places)) {
  return [set](GridLiquid& self, const Reals& values, const LongIndices& places) {
    (self.*set)(Points(values), rows_in(places, self.size()));
  };
}
// Numbers that take a while to find.
auto found(std::vector<double> (GridLiquid::*get)()) {
  return [get](GridLiquid& self) {
    std::vector<double> values;
    {
      const py::gil_scoped_release released;
      values = (self.*get)();
    }
    return column(values);
  };
}

py::dict grid_liquid_state(const GridLiquid& self) {
  const gridfluid::LiquidState s = self.state();
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
  out["deep"] = column(s.deep);
  out["deep_velocity"] = rows(s.deep_velocity, 0);
  out["seeded"] = s.seeded;
  out["missing"] = s.missing;
  return out;
}

void restore_grid_liquid(GridLiquid& self, double time, double last_dt, std::int64_t next_id,
                         const py::array& positions, const py::array& velocities,
                         const py::array& affine, const py::array& forces, const LongIndices& ids,
                         const Reals& pressure, const Array<std::uint8_t>& deep,
                         const py::array& deep_velocity, std::int64_t seeded, std::int64_t missing,
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
                .deep = list(deep),
                .deep_velocity = numbers(deep_velocity),
                .seeded = seeded,
                .missing = missing,
                .flow = {.layers = list(layers), .absorbed = list(absorbed)}});
}

void bind_grid_liquid_reports(py::module_& m) {
  py::class_<gridfluid::LiquidReport>(m, "LiquidReport")
      .def_readonly("iterations", &gridfluid::LiquidReport::iterations)
      .def_readonly("residual", &gridfluid::LiquidReport::residual)
      .def_readonly("converged", &gridfluid::LiquidReport::converged)
      .def_readonly("viscosity_iterations", &gridfluid::LiquidReport::viscosity_iterations)
      .def_readonly("viscosity_converged", &gridfluid::LiquidReport::viscosity_converged)
      .def_readonly("volume_iterations", &gridfluid::LiquidReport::volume_iterations)
      .def_readonly("mean_error", &gridfluid::LiquidReport::mean_error)
      .def_readonly("removed", &gridfluid::LiquidReport::removed);
  py::class_<gridfluid::LiquidEnergies>(m, "LiquidEnergies")
      .def_readonly("kinetic", &gridfluid::LiquidEnergies::kinetic)
      .def_readonly("potential", &gridfluid::LiquidEnergies::potential)
      .def_property_readonly("momentum",
                             [](const gridfluid::LiquidEnergies& e) { return triple(e.momentum); })
      .def_property_readonly("angular_momentum", [](const gridfluid::LiquidEnergies& e) {
        return triple(e.angular_momentum);
      });
}

}  // namespace

void bind_grid_liquid(py::module_& m) {
  bind_grid_liquid_reports(m);
  py::class_<GridLiquid, substep::Simulation>(m, "GridLiquid")
      .def(py::init([](std::vector<std::shared_ptr<substep::geometry::Collider>> colliders,
                       const substep::geometry::ParticleFlow& flow, const py::dict& given,
                       const std::string& dtype) {
             return gridfluid::make_liquid(precision(dtype), std::move(colliders),
                                           grid_liquid_options(given), flow);
           }),
           py::arg("colliders"), py::arg("flow"), py::arg("options"), py::arg("dtype"))
      .def(
          "add",
          [](GridLiquid& self, const Reals& positions, const Reals& velocities) {
            return self.add(Points(positions), Points(velocities));
          },
          py::arg("positions").noconvert(), py::arg("velocities").noconvert())
      .def(
          "remove",
          [](GridLiquid& self, const LongIndices& places) {
            self.remove(rows_in(places, self.size()));
          },
          py::arg("places").noconvert())
      .def("step", &GridLiquid::step, py::arg("dt"), py::call_guard<py::gil_scoped_release>())
      .def("keep", &GridLiquid::keep)
      .def("rewind", &GridLiquid::rewind)
      .def("__len__", &GridLiquid::size)
      .def_property_readonly("deep_cells", &GridLiquid::deep_cells)
      .def_property("time", &GridLiquid::time, &GridLiquid::set_time)
      .def_property("threads", &GridLiquid::threads, &GridLiquid::set_threads)
      .def_property_readonly("report", &GridLiquid::report)
      .def_property_readonly("energies", &GridLiquid::energies)
      .def_property_readonly("fastest", &GridLiquid::fastest)
      .def_property_readonly("layers",
                             [](const GridLiquid& self) { return column(self.counts().layers); })
      .def_property_readonly("absorbed",
                             [](const GridLiquid& self) { return column(self.counts().absorbed); })
      .def("ids", [](const GridLiquid& self) { return column(self.ids()); })
      .def("positions", rows_of_liquid(&GridLiquid::positions))
      .def("velocities", rows_of_liquid(&GridLiquid::velocities))
      .def("pressure", [](const GridLiquid& self) { return column(self.pressure()); })
      .def("level_set", found(&GridLiquid::level_set))
      .def("grid_velocity", found(&GridLiquid::grid_velocity))
      .def("set_positions", set_liquid_rows(&GridLiquid::set_positions),
           py::arg("values").noconvert(), py::arg("places").noconvert())
      .def("set_velocities", set_liquid_rows(&GridLiquid::set_velocities),
           py::arg("values").noconvert(), py::arg("places").noconvert())
      .def("set_forces", set_liquid_rows(&GridLiquid::set_forces), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("state", &grid_liquid_state)
      .def("restore", &restore_grid_liquid, py::arg("time"), py::arg("last_dt"), py::arg("next_id"),
           py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
           py::arg("affine").noconvert(), py::arg("forces").noconvert(), py::arg("ids").noconvert(),
           py::arg("pressure").noconvert(), py::arg("deep").noconvert(),
           py::arg("deep_velocity").noconvert(), py::arg("seeded"), py::arg("missing"),
           py::arg("layers").noconvert(), py::arg("absorbed").noconvert());
}
