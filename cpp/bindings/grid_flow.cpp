#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/gridfluid/flow/any_grid_flow.h"

namespace {

using namespace substep::gridfluid;
using substep::geometry::Collider;

// What flows, and what the flow is like, of dictionaries that Python has checked.
FlowOptions flow_options(const py::dict& given) {
  FlowOptions o;
  o.density = number(given, "density");
  o.viscosity = number(given, "viscosity");
  o.gravity = vector(given, "gravity");
  o.slip = flag(given, "slip");
  o.vorticity_confinement = number(given, "vorticity_confinement");
  const std::string advection = word(given, "advection");
  o.advection = advection == "central"      ? FlowAdvection::kCentral
                : advection == "maccormack" ? FlowAdvection::kMacCormack
                                            : FlowAdvection::kSemiLagrangian;
  o.tolerance = number(given, "tolerance");
  o.max_iterations = integer(given, "max_iterations");
  o.smoke = integer(given, "smoke");
  o.smoke_density = number(given, "smoke_density");
  for (const py::handle each : given["scalars"]) {
    const auto scalar = each.cast<py::dict>();
    o.scalars.push_back({.diffusivity = number(scalar, "diffusivity"),
                         .buoyancy = number(scalar, "buoyancy"),
                         .ambient = number(scalar, "ambient")});
  }
  return o;
}

Side side(const py::dict& given) {
  const std::string kind = word(given, "kind");
  return {.kind = kind == "open"       ? SideKind::kOpen
                  : kind == "periodic" ? SideKind::kPeriodic
                  : kind == "inflow"   ? SideKind::kInflow
                                       : SideKind::kWall,
          .slip = flag(given, "slip"),
          .velocity = given["velocity"].cast<std::vector<double>>(),
          .scalar = given["scalar"].cast<std::vector<double>>(),
          .holds = given["holds"].cast<std::vector<bool>>()};
}

FlowBox box(const py::dict& given) {
  FlowBox out{.dimension = integer(given, "dimension"),
              .cells = given["cells"].cast<std::array<int, 3>>(),
              .low = vector(given, "low"),
              .dx = number(given, "cell"),
              .sides = {}};
  const py::list sides = given["sides"];
  for (std::size_t a = 0; a < sides.size(); ++a) {
    const py::list ends = sides[a];
    for (std::size_t end = 0; end < 2; ++end) out.sides[a][end] = side(ends[end].cast<py::dict>());
  }
  return out;
}

std::vector<FlowSource> flow_sources(const py::list& given) {
  std::vector<FlowSource> out;
  for (const py::handle each : given) {
    const auto source = each.cast<py::dict>();
    FlowSource one{.region = *source["region"].cast<std::shared_ptr<Collider>>(),
                   .held = source["held"].cast<std::vector<std::optional<double>>>(),
                   .rate = source["rate"].cast<std::vector<double>>(),
                   .velocity = {}};
    if (!source["velocity"].is_none()) one.velocity = vector(source, "velocity");
    out.push_back(std::move(one));
  }
  return out;
}

py::list arrays(const std::vector<substep::Numbers>& values) {
  py::list out;
  for (const substep::Numbers& x : values) out.append(rows(x, 0));
  return out;
}
std::vector<substep::Numbers> all_numbers(const py::list& values) {
  std::vector<substep::Numbers> out;
  for (const py::handle x : values) out.push_back(numbers(x.cast<py::array>()));
  return out;
}

py::dict flow_state(const AnyGridFlow& self) {
  const FlowState s = self.state();
  py::dict out;
  out["time"] = s.time;
  out["velocity"] = arrays(s.velocity);
  out["scalars"] = arrays(s.scalars);
  out["pressure"] = column(s.pressure);
  return out;
}

void bind_flow_reports(py::module_& m) {
  py::class_<FlowReport>(m, "FlowReport")
      .def_readonly("solver", &FlowReport::solver)
      .def_readonly("iterations", &FlowReport::iterations)
      .def_readonly("residual", &FlowReport::residual)
      .def_readonly("converged", &FlowReport::converged)
      .def_readonly("viscosity_iterations", &FlowReport::viscosity_iterations)
      .def_readonly("viscosity_converged", &FlowReport::viscosity_converged);
  py::class_<FlowSums>(m, "FlowSums")
      .def_readonly("kinetic", &FlowSums::kinetic)
      .def_property_readonly("momentum", [](const FlowSums& s) { return triple(s.momentum); })
      .def_readonly("divergence", &FlowSums::divergence)
      .def_readonly("speed", &FlowSums::speed)
      .def_readonly("scalars", &FlowSums::scalars);
  py::class_<FlowLimits>(m, "FlowLimits")
      .def_readonly("courant", &FlowLimits::courant)
      .def_readonly("acceleration", &FlowLimits::acceleration)
      .def_readonly("longest", &FlowLimits::longest);
}

}  // namespace

void bind_grid_flow(py::module_& m) {
  bind_flow_reports(m);
  using Released = py::call_guard<py::gil_scoped_release>;
  py::class_<AnyGridFlow>(m, "GridFlow")
      .def(py::init([](const py::dict& where, std::vector<std::shared_ptr<Collider>> colliders,
                       const py::list& sources, const py::dict& given, const std::string& dtype) {
             return make_flow(precision(dtype), box(where), std::move(colliders),
                              flow_sources(sources), flow_options(given));
           }),
           py::arg("box"), py::arg("colliders"), py::arg("sources"), py::arg("options"),
           py::arg("dtype"))
      .def("step", &AnyGridFlow::step, py::arg("dt"), Released())
      .def_property("time", &AnyGridFlow::time, &AnyGridFlow::set_time)
      .def_property("threads", &AnyGridFlow::threads, &AnyGridFlow::set_threads)
      .def_property_readonly("report", &AnyGridFlow::report)
      .def("sums", &AnyGridFlow::sums, Released())
      .def("limits", &AnyGridFlow::limits, Released())
      .def("velocities",
           [](const AnyGridFlow& self) { return table(self.velocities(), self.dimension()); })
      .def(
          "velocity", [](const AnyGridFlow& self, int axis) { return column(self.velocity(axis)); },
          py::arg("axis"))
      .def(
          "scalar", [](const AnyGridFlow& self, int k) { return column(self.scalar(k)); },
          py::arg("number"))
      .def("pressure", [](const AnyGridFlow& self) { return column(self.pressure()); })
      .def("fluid", [](AnyGridFlow& self) { return column(self.fluid()); })
      .def(
          "sample",
          [](AnyGridFlow& self, const Reals& points) {
            const Points at(points);
            const std::vector<double> values = [&] {
              const py::gil_scoped_release released;
              return self.sample(at);
            }();
            const auto rows_of =
                static_cast<py::ssize_t>(values.size()) / std::max(points.shape(0), py::ssize_t{1});
            return table(values, std::max(rows_of, py::ssize_t{1}));
          },
          py::arg("points").noconvert())
      .def("project", &AnyGridFlow::project, Released())
      .def("set_velocity", &AnyGridFlow::set_velocity, py::arg("faces"), Released())
      .def(
          "set_scalar",
          [](AnyGridFlow& self, int k, const Reals& values) {
            self.set_scalar(k, readable(values));
          },
          py::arg("number"), py::arg("values").noconvert())
      .def("state", &flow_state)
      .def(
          "restore",
          [](AnyGridFlow& self, double time, const py::list& velocity, const py::list& scalars,
             const Reals& pressure) {
            self.restore({.time = time,
                          .velocity = all_numbers(velocity),
                          .scalars = all_numbers(scalars),
                          .pressure = list(pressure)});
          },
          py::arg("time"), py::arg("velocity"), py::arg("scalars"),
          py::arg("pressure").noconvert());
}
