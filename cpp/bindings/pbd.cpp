#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/pbd/groups/constraints.h"
#include "substep/pbd/solver/body.h"

namespace {

using namespace substep::pbd;
using substep::geometry::Collider;

using Flags = Array<std::uint8_t>;
using Ids = Array<std::int64_t>;

static_assert(sizeof(Triple) == 3 * sizeof(double));

Body::Rows triples(const Reals& a) {
  return {reinterpret_cast<const Triple*>(a.data()), static_cast<std::size_t>(a.size()) / 3};
}

auto rows_of(std::vector<double> (Body::*get)() const) {
  return [get](const Body& self) { return table((self.*get)(), 3); };
}
auto set_all(void (Body::*set)(Body::Rows)) {
  return [set](Body& self, const Reals& values) { (self.*set)(triples(values)); };
}
auto set_some(void (Body::*set)(Body::Ids, Body::Rows)) {
  return [set](Body& self, const Ids& ids, const Reals& values) {
    (self.*set)(readable(ids), triples(values));
  };
}
auto of_group(std::vector<double> (Body::*get)(std::size_t)) {
  return [get](Body& self, std::size_t group) { return column((self.*get)(group)); };
}

std::unique_ptr<Body> make_body(const Reals& positions, const Reals& velocities,
                                const Reals& masses, const Flags& pinned, const py::list& groups,
                                const py::dict& given, Body::Colliders colliders,
                                const std::string& dtype) {
  std::vector<const Recipe*> recipes;
  for (const py::handle group : groups) recipes.push_back(group.cast<const Recipe*>());
  const Options options{.substeps = integer(given, "substeps"),
                        .iterations = integer(given, "iterations"),
                        .jacobi = word(given, "solver") == "jacobi",
                        .relaxation = number(given, "relaxation"),
                        .gravity = triple(vector(given, "gravity")),
                        .damping = number(given, "damping"),
                        .margin = number(given, "margin"),
                        .dimension = integer(given, "dimension")};
  const auto x = triples(positions), v = triples(velocities);
  const auto m = readable(masses);
  const auto pins = readable(pinned);
  const substep::Precision of = precision(dtype);
  const py::gil_scoped_release released;
  return make_body(of, x, v, m, pins, recipes, std::move(colliders), options);
}

void bind_body(py::module_& m) {
  py::class_<Body, substep::Simulation>(m, "PositionBasedDynamics")
      .def(py::init(&make_body), py::arg("positions").noconvert(),
           py::arg("velocities").noconvert(), py::arg("masses").noconvert(),
           py::arg("pinned").noconvert(), py::arg("groups"), py::arg("options"),
           py::arg("colliders"), py::arg("dtype"))
      .def("copy", &Body::copy, py::arg("colliders"))
      .def(
          "use_multilevel",
          [](Body& self, const Indices& pairs, const Reals& lengths, const Reals& rest) {
            self.use_multilevel(readable(pairs), readable(lengths), triples(rest));
          },
          py::arg("pairs").noconvert(), py::arg("lengths").noconvert(), py::arg("rest").noconvert())
      .def_property_readonly("level_sizes", &Body::level_sizes)
      .def_property("time", &Body::time, &Body::set_time)
      .def_property("threads", &Body::threads, &Body::set_threads)
      .def_property_readonly("origin", &Body::origin)
      .def_property_readonly("groups", &Body::groups)
      .def_property_readonly("skipped", &Body::skipped)
      .def_property_readonly("last_substep", &Body::last_substep)
      .def_property_readonly("elastic_energy", &Body::elastic_energy)
      .def("step", &Body::step, py::arg("dt"), py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("positions", rows_of(&Body::positions))
      .def_property_readonly("velocities", rows_of(&Body::velocities))
      .def_property("forces", rows_of(&Body::forces), set_all(&Body::set_forces))
      .def_property("targets", rows_of(&Body::targets), set_all(&Body::set_targets))
      .def_property(
          "pinned", [](const Body& self) { return column(self.pinned()); },
          [](Body& self, const Flags& pinned) { self.set_pinned(readable(pinned)); })
      .def("set_positions", set_some(&Body::set_positions), py::arg("ids").noconvert(),
           py::arg("values").noconvert())
      .def("set_velocities", set_some(&Body::set_velocities), py::arg("ids").noconvert(),
           py::arg("values").noconvert())
      .def("raw",
           [](const Body& self) {
             const Body::Raw raw = self.raw();
             return py::make_tuple(rows(raw.positions, 3), rows(raw.velocities, 3),
                                   rows(raw.targets, 3));
           })
      .def(
          "set_raw",
          [](Body& self, const py::array& x, const py::array& v, const py::array& targets) {
            self.set_raw({numbers(x), numbers(v), numbers(targets)});
          },
          py::arg("positions"), py::arg("velocities"), py::arg("targets"))
      .def("values", of_group(&Body::values), py::arg("group"))
      .def("multipliers", of_group(&Body::multipliers), py::arg("group"))
      .def("group_state", of_group(&Body::group_state), py::arg("group"))
      .def(
          "set_group_state",
          [](Body& self, std::size_t group, const Reals& state) {
            self.set_group_state(group, readable(state));
          },
          py::arg("group"), py::arg("state").noconvert());
}

}  // namespace

void bind_pbd(py::module_& m) {
  bind_pbd_constraints(m);
  bind_body(m);
  m.def("constraint_kinds", [] {
    py::dict all;
    for (const ConstraintKind& kind : constraint_kinds()) {
      py::dict what;
      what["points"] = kind.points;
      what["parameters"] = kind.parameters;
      what["inequality"] = kind.inequality;
      all[py::str(kind.name)] = what;
    }
    return all;
  });
  m.def(
      "evaluate_constraints",
      [](const std::string& kind, const Reals& x, const Reals& parameters) {
        const py::ssize_t count = x.shape(0);
        Reals c(count), gradient({count, x.shape(1), py::ssize_t{3}});
        evaluate_constraints(kind, static_cast<std::size_t>(count), x.data(), parameters.data(),
                             c.mutable_data(), gradient.mutable_data());
        return std::pair(c, gradient);
      },
      py::arg("kind"), py::arg("x").noconvert(), py::arg("parameters").noconvert());
}
