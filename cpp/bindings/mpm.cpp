#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/core/errors.h"
#include "substep/mpm/solver/method.h"

namespace {

using namespace substep::mpm;
using substep::geometry::Collider;
using substep::geometry::ParticleFlow;

template <class Value>
Value choice(const std::string& name, std::initializer_list<std::pair<const char*, Value>> names) {
  for (const auto& [known, value] : names) {
    if (name == known) return value;
  }
  throw substep::InputError("options: there is no " + name);
}

Settings settings(const py::dict& given) {
  Settings o;
  o.cell = number(given, "cell");
  o.order = integer(given, "order");
  o.transfer = choice<Transfer>(word(given, "transfer"), {{"pic", Transfer::kPic},
                                                          {"flip", Transfer::kFlip},
                                                          {"apic", Transfer::kApic},
                                                          {"aflip", Transfer::kAflip}});
  o.form = choice<Form>(word(given, "form"), {{"mls", Form::kMls}, {"textbook", Form::kTextbook}});
  o.integrator = choice<Integrator>(
      word(given, "integrator"),
      {{"explicit", Integrator::kExplicit}, {"implicit", Integrator::kImplicit}});
  o.flip_rate = number(given, "flip_rate");
  o.gravity = vector(given, "gravity");
  o.cfl = number(given, "cfl");
  o.largest = number(given, "largest_step");
  o.step = number(given, "step");  // 0: by the limits
  o.on_large_step =
      choice<OnLargeStep>(word(given, "on_large_step"),
                          {{"raise", OnLargeStep::kRaise}, {"subdivide", OnLargeStep::kSubdivide}});
  o.on_escape = choice<OnEscape>(
      word(given, "on_escape"),
      {{"raise", OnEscape::kRaise}, {"remove", OnEscape::kRemove}, {"clamp", OnEscape::kClamp}});
  for (const py::handle name : py::list(given["boundaries"])) {
    o.boundaries.push_back(
        choice<Boundary>(name.cast<std::string>(), {{"sticky", Boundary::kSticky},
                                                    {"slip", Boundary::kSlip},
                                                    {"separate", Boundary::kSeparate}}));
  }
  if (!given["bounds"].is_none()) {
    const auto bounds = given["bounds"].cast<std::array<Triple, 2>>();
    o.bounds = {vector(bounds[0]), vector(bounds[1])};
  }
  return o;
}

std::vector<MaterialConstants> materials(const py::dict& given) {
  std::vector<MaterialConstants> all;
  for (const py::handle one : py::list(given["materials"])) {
    const py::sequence pair = one.cast<py::sequence>();
    MaterialConstants material{pair[0].cast<std::string>(), {}};
    for (const auto& [name, value] : pair[1].cast<py::dict>())
      material.values[name.cast<std::string>()] = value.cast<double>();
    all.push_back(std::move(material));
  }
  return all;
}

// {kind: (has_F, [(name, unit, initial)])}.
py::dict state_fields() {
  py::dict all;
  for (const MaterialFields& material : material_fields()) {
    py::list own;
    for (const StateField& f : material.own) own.append(py::make_tuple(f.name, f.unit, f.initial));
    all[material.kind] = py::make_tuple(material.has_F, own);
  }
  return all;
}

py::dict state(const Method& self) {
  MethodState s;
  {
    const py::gil_scoped_release released;
    s = self.state();
  }
  const auto n = static_cast<py::ssize_t>(s.ids.size()), d = py::ssize_t{self.dimension()};
  py::dict out;
  out["time"] = s.clock.time;
  out["supplied"] = s.clock.supplied;
  out["drift"] = s.clock.drift;
  out["next_id"] = s.clock.next_id;
  out["trial"] = s.clock.trial;
  out["before"] = s.clock.before;
  out["counts"] = column(s.counts);
  out["ids"] = column(s.ids);
  out["blocks"] = made(Array<std::int32_t>({n, d}, s.blocks.data()));
  out["values"] = rows(s.values, 0);
  out["motion"] = rows(s.motion, d + d * d);
  out["volumes"] = rows(s.volumes, 0);
  out["forces"] = made(Reals({static_cast<py::ssize_t>(s.forces.size()), py::ssize_t{3}},
                             s.forces.empty() ? nullptr : s.forces[0].data()));
  return out;
}

void restore(Method& self, const py::dict& from) {
  const auto forces = from["forces"].cast<Reals>();
  self.restore({.clock = {.time = number(from, "time"),
                          .supplied = number(from, "supplied"),
                          .drift = number(from, "drift"),
                          .next_id = from["next_id"].cast<std::int64_t>(),
                          .trial = flag(from, "trial"),
                          .before = number(from, "before")},
                .counts = list(from["counts"].cast<Array<std::int64_t>>()),
                .ids = list(from["ids"].cast<Array<std::int32_t>>()),
                .blocks = list(from["blocks"].cast<Array<std::int32_t>>()),
                .values = numbers(from["values"]),
                .motion = numbers(from["motion"]),
                .volumes = numbers(from["volumes"]),
                .forces = forces.size() == 0 ? std::vector<Vec3>{} : Points(forces).copied(),
                .flow = {.layers = list(from["layers"].cast<LongIndices>()),
                         .absorbed = list(from["absorbed"].cast<LongIndices>())}});
}

// Rows of D to so many powers, or of so many numbers.
auto rows_of(std::vector<double> (Method::*get)() const, int power) {
  return [get, power](const Method& self) {
    return table((self.*get)(), Sizes(static_cast<std::size_t>(power), self.dimension()));
  };
}
auto setter(void (Method::*set)(std::span<const Vec3>, Method::Places)) {
  return [set](Method& self, const Reals& values, const Array<std::int64_t>& places) {
    (self.*set)(Points(values), rows_in(places, self.size()));
  };
}

// Objects of Python alone: it is asked for when a step has been taken, and that must not fail.
py::dict report(const Method& self) {
  const Report report = self.report();
  py::dict all;
  all["steps"] = report.steps;
  all["sorts"] = report.sorts;
  all["subdivided"] = report.subdivided;
  all["dt"] = report.dt;
  all["limit"] = report.limit;
  all["removed"] = report.removed;
  all["clamped"] = report.clamped;
  all["newton"] = report.newton;
  all["krylov"] = report.krylov;
  return all;
}

void bind_method(py::module_& m) {
  py::class_<Method, substep::Simulation>(m, "MaterialPointMethod")
      .def(py::init([](const py::dict& given, std::vector<std::shared_ptr<Collider>> colliders,
                       const ParticleFlow& flow, int dimension, const std::string& dtype) {
             return make_method(precision(dtype), dimension, settings(given), materials(given),
                                std::move(colliders), flow);
           }),
           py::arg("options"), py::arg("colliders"), py::arg("flow"), py::arg("dimension"),
           py::arg("dtype"))
      .def(
          "add",
          [](Method& self, const Reals& positions, const Reals& velocities,
             const Array<std::int32_t>& materials, const Reals& volumes) {
            const Points x(positions), v(velocities);
            const auto which = readable(materials);
            const auto V = readable(volumes);
            const py::gil_scoped_release released;
            return self.add(x, v, which, V);
          },
          py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
          py::arg("materials").noconvert(), py::arg("volumes").noconvert())
      .def(
          "remove",
          [](Method& self, const Array<std::int64_t>& places) {
            const auto which = rows_in(places, self.size());
            const py::gil_scoped_release released;
            self.remove(which);
          },
          py::arg("places").noconvert())
      .def("step", &Method::step, py::arg("dt"), py::call_guard<py::gil_scoped_release>())
      .def("step_by_limit", &Method::step_by_limit, py::call_guard<py::gil_scoped_release>())
      .def("advance", &Method::advance, py::arg("end"), py::call_guard<py::gil_scoped_release>())
      .def("advance_once", &Method::advance_once, py::arg("end"), py::arg("first"),
           py::call_guard<py::gil_scoped_release>())
      .def("step_limit",
           [](const Method& self) {
             StepLimit limit;
             {
               const py::gil_scoped_release released;
               limit = self.step_limit();
             }
             return py::make_tuple(limit.dt, limit.reason);
           })
      .def("__len__", &Method::size)
      .def_property("time", &Method::time, &Method::set_time)
      .def_property("threads", &Method::threads, &Method::set_threads)
      .def_property_readonly("report", &report)
      .def("diagnostics", &Method::diagnostics, py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("layers",
                             [](const Method& self) { return column(self.counts().layers); })
      .def_property_readonly("absorbed",
                             [](const Method& self) { return column(self.counts().absorbed); })
      .def("ids", [](const Method& self) { return column(self.ids()); })
      .def("materials", [](const Method& self) { return column(self.materials()); })
      .def("positions", rows_of(&Method::positions, 1))
      .def("velocities", rows_of(&Method::velocities, 1))
      .def("affine", rows_of(&Method::affine, 2))
      .def("volumes", rows_of(&Method::volumes, 0))
      .def("elastic_energies", rows_of(&Method::elastic_energies, 0))
      .def("stresses", [](const Method& self) { return table(self.stresses(), 6); })
      .def(
          "material_fields",
          [](const Method& self, int of) {
            return table(self.material_fields(of), self.field_count(of));
          },
          py::arg("material"))
      .def("set_positions", setter(&Method::set_positions), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("set_velocities", setter(&Method::set_velocities), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def("set_forces", setter(&Method::set_forces), py::arg("values").noconvert(),
           py::arg("places").noconvert())
      .def(
          "set_affine",
          [](Method& self, const Reals& values, const Array<std::int64_t>& places) {
            self.set_affine(readable(values), rows_in(places, self.size()));
          },
          py::arg("values").noconvert(), py::arg("places").noconvert())
      .def(
          "set_material_fields",
          [](Method& self, int of, const Reals& values, const Array<std::int64_t>& places) {
            self.set_material_fields(of, readable(values), rows_in(places, self.size()));
          },
          py::arg("material"), py::arg("values").noconvert(), py::arg("places").noconvert())
      .def("state", &state)
      .def("restore", &restore, py::arg("state"));
}

}  // namespace

void bind_mpm(py::module_& m) {
  py::class_<Diagnostics>(m, "MaterialPointSums")
      .def_readonly("mass", &Diagnostics::mass)
      .def_readonly("kinetic", &Diagnostics::kinetic)
      .def_readonly("potential", &Diagnostics::potential)
      .def_readonly("elastic", &Diagnostics::elastic)
      .def_readonly("dissipated", &Diagnostics::dissipated)
      .def_property_readonly("momentum", [](const Diagnostics& s) { return triple(s.momentum); })
      .def_property_readonly("angular_momentum",
                             [](const Diagnostics& s) { return triple(s.angular_momentum); });
  m.def("material_state_fields", &state_fields);
  bind_method(m);
}
