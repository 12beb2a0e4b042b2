#include <pybind11/stl.h>

#include "bindings.h"
#include "pbd_groups.h"
#include "substep/core/errors.h"
#include "substep/pbd/groups/constraints.h"
#include "substep/pbd/solver/dynamics.h"
#include "substep/pbd/solver/multilevel.h"

namespace {

using namespace substep::pbd;
using substep::geometry::Collider;

using Reals = py::array_t<double, py::array::c_style>;
using Flags = py::array_t<std::uint8_t, py::array::c_style>;
using Indices = py::array_t<std::int32_t, py::array::c_style>;
using Ids = py::array_t<std::int64_t, py::array::c_style>;

static_assert(sizeof(Triple) == 3 * sizeof(double));

template <class T>
std::vector<T> list(const py::array_t<T, py::array::c_style>& a) {
  return {a.data(), a.data() + a.size()};
}
std::span<const Triple> rows(const Reals& a) {
  return {reinterpret_cast<const Triple*>(a.data()), static_cast<std::size_t>(a.size()) / 3};
}
template <class T>
std::span<const T> readable(const py::array_t<T, py::array::c_style>& a) {
  return {a.data(), static_cast<std::size_t>(a.size())};
}
template <class T>
std::span<T> writable(py::array_t<T, py::array::c_style>& a) {
  return {a.mutable_data(), static_cast<std::size_t>(a.size())};
}
template <class Fill>
Reals vectors(std::int64_t count, Fill&& fill) {
  Reals out({static_cast<py::ssize_t>(count), py::ssize_t{3}});
  fill(std::span(reinterpret_cast<Triple*>(out.mutable_data()), static_cast<std::size_t>(count)));
  return out;
}

std::vector<DistanceGraph::Edge> distance_edges(const std::vector<std::int32_t>& pairs,
                                                const std::vector<double>& lengths) {
  std::vector<DistanceGraph::Edge> edges;
  edges.reserve(lengths.size());
  for (std::size_t k = 0; k < lengths.size(); ++k) {
    edges.push_back({pairs[2 * k], pairs[2 * k + 1], lengths[k]});
  }
  return edges;
}

// With the colliders of Python, which it moves and which are read before each step.
template <class Real>
struct Body : substep::pbd::Dynamics<Real> {
  template <class... Arguments>
  explicit Body(std::vector<std::shared_ptr<Collider>> given, Arguments&&... arguments)
      : substep::pbd::Dynamics<Real>(std::forward<Arguments>(arguments)...),
        colliders(std::move(given)) {}

  void step(double dt) {
    if (!this->contact) return substep::pbd::Dynamics<Real>::step(dt);
    std::vector<Collider>& own = this->contact->colliders;
    for (std::size_t c = 0; c < colliders.size(); ++c) own[c] = *colliders[c];
    substep::pbd::Dynamics<Real>::step(dt);
    for (std::size_t c = 0; c < colliders.size(); ++c) *colliders[c] = own[c];
  }

  std::vector<std::shared_ptr<Collider>> colliders;
};

template <class Real>
void bind_dynamics(py::module_& m, const char* group_name, const char* name) {
  using Dynamics = Body<Real>;
  using Raw = py::array_t<Real, py::array::c_style>;
  py::class_<GroupHandle<Real>>(m, group_name)
      .def(py::init([](const std::string& kind, const Indices& particles, const Reals& parameters,
                       const Reals& compliance, const Reals& damping, const Reals& stiffness) {
             const Softness softness{.physical = stiffness.size() == 0,
                                     .compliance = list(compliance),
                                     .damping = list(damping),
                                     .stiffness = list(stiffness)};
             return GroupHandle<Real>{
                 make_group<Real>(kind, list(particles), list(parameters), softness)};
           }),
           py::arg("kind"), py::arg("particles").noconvert(), py::arg("parameters").noconvert(),
           py::arg("compliance").noconvert(), py::arg("damping").noconvert(),
           py::arg("stiffness").noconvert());
  py::class_<Dynamics>(m, name)
      .def(py::init([](const Reals& positions, const Reals& velocities, const Reals& masses,
                       const Flags& pinned, const std::vector<GroupHandle<Real>*>& handles,
                       int substeps, int iterations, const std::string& solver, double relaxation,
                       const Triple& gravity, double damping,
                       const std::vector<std::shared_ptr<Collider>>& colliders, double margin,
                       int dimension) {
             std::vector<std::unique_ptr<Group<Real>>> groups;
             for (const auto* handle : handles) groups.push_back(handle->group->clone());
             const Options options{.substeps = substeps,
                                   .iterations = iterations,
                                   .jacobi = solver == "jacobi",
                                   .relaxation = relaxation,
                                   .gravity = gravity,
                                   .damping = damping,
                                   .margin = margin,
                                   .dimension = dimension};
             std::vector<Collider> obstacles;
             for (const auto& collider : colliders) obstacles.push_back(*collider);
             const auto x = rows(positions), v = rows(velocities);
             const std::span mass(masses.data(), static_cast<std::size_t>(masses.size()));
             const std::span pins(pinned.data(), static_cast<std::size_t>(pinned.size()));
             const py::gil_scoped_release released;
             return new Dynamics(colliders, x, v, mass, pins, std::move(groups),
                                 std::move(obstacles), options);
           }),
           py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
           py::arg("masses").noconvert(), py::arg("pinned").noconvert(), py::arg("groups"),
           py::arg("substeps"), py::arg("iterations"), py::arg("solver"), py::arg("relaxation"),
           py::arg("gravity"), py::arg("damping"), py::arg("colliders"), py::arg("margin"),
           py::arg("dimension"))
      .def(
          "copy",
          [](const Dynamics& self, const std::vector<std::shared_ptr<Collider>>& colliders) {
            return new Dynamics(colliders, self);
          },
          py::arg("colliders"))
      .def(
          "use_multilevel",
          [](Dynamics& self, const Indices& pairs, const Reals& lengths, const Reals& rest) {
            const auto at = rows(rest);
            auto solver = std::make_unique<Multilevel<Real>>(
                distance_edges(list(pairs), list(lengths)), std::vector(at.begin(), at.end()));
            solver->attach(self.partition());
            self.projector = std::move(solver);
          },
          py::arg("pairs").noconvert(), py::arg("lengths").noconvert(), py::arg("rest").noconvert())
      .def_property_readonly("level_sizes",
                             [](const Dynamics& self) {
                               const auto* solver =
                                   dynamic_cast<const Multilevel<Real>*>(self.projector.get());
                               return solver ? solver->level_sizes() : std::vector<std::int64_t>{};
                             })
      .def_readwrite("time", &Dynamics::time)
      .def_property(
          "threads", [](const Dynamics& self) { return self.options.threads; },
          [](Dynamics& self, int threads) { self.options.threads = threads; })
      .def_property_readonly("origin", &Dynamics::origin)
      .def_property_readonly("groups", &Dynamics::groups)
      .def_property_readonly("skipped", &Dynamics::skipped)
      .def_property_readonly("last_substep", &Dynamics::last_substep)
      .def_property_readonly("elastic_energy", &Dynamics::elastic_energy)
      .def("step", &Dynamics::step, py::arg("dt"), py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("positions",
                             [](const Dynamics& self) {
                               return vectors(self.size(),
                                              [&](std::span<Triple> out) { self.positions(out); });
                             })
      .def_property_readonly("velocities",
                             [](const Dynamics& self) {
                               return vectors(self.size(),
                                              [&](std::span<Triple> out) { self.velocities(out); });
                             })
      .def_property(
          "forces",
          [](const Dynamics& self) {
            return vectors(self.size(), [&](std::span<Triple> out) { self.forces(out); });
          },
          [](Dynamics& self, const Reals& values) { self.set_forces(rows(values)); })
      .def_property(
          "targets",
          [](const Dynamics& self) {
            return vectors(self.size(), [&](std::span<Triple> out) { self.targets(out); });
          },
          [](Dynamics& self, const Reals& values) { self.set_targets(rows(values)); })
      .def_property(
          "pinned",
          [](const Dynamics& self) {
            const auto flags = self.pinned();
            return Flags(static_cast<py::ssize_t>(flags.size()), flags.data());
          },
          [](Dynamics& self, const Flags& pinned) { self.set_pinned(readable(pinned)); })
      .def(
          "set_positions",
          [](Dynamics& self, const Ids& ids, const Reals& values) {
            self.set_positions(readable(ids), rows(values));
          },
          py::arg("ids").noconvert(), py::arg("values").noconvert())
      .def(
          "set_velocities",
          [](Dynamics& self, const Ids& ids, const Reals& values) {
            self.set_velocities(readable(ids), rows(values));
          },
          py::arg("ids").noconvert(), py::arg("values").noconvert())
      .def("raw",
           [](const Dynamics& self) {
             const auto n = static_cast<py::ssize_t>(self.size());
             Raw x({n, py::ssize_t{3}}), v({n, py::ssize_t{3}});
             Raw targets({self.has_targets() ? n : 0, py::ssize_t{3}});
             self.raw(writable(x), writable(v), writable(targets));
             return std::tuple(x, v, targets);
           })
      .def(
          "set_raw",
          [](Dynamics& self, const Raw& x, const Raw& v, const Raw& targets) {
            self.set_raw(readable(x), readable(v), readable(targets));
          },
          py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
          py::arg("targets").noconvert())
      .def(
          "values",
          [](Dynamics& self, std::size_t group) {
            Reals c(static_cast<py::ssize_t>(self.group(group).size()));
            self.values(group, writable(c));
            return c;
          },
          py::arg("group"))
      .def(
          "multipliers",
          [](Dynamics& self, std::size_t group) {
            Reals c(static_cast<py::ssize_t>(self.group(group).size()));
            self.multipliers(group, writable(c));
            return c;
          },
          py::arg("group"))
      .def(
          "group_state",
          [](Dynamics& self, std::size_t group) {
            const auto state = self.group(group).state();
            return Reals(static_cast<py::ssize_t>(state.size()), state.data());
          },
          py::arg("group"))
      .def(
          "set_group_state",
          [](Dynamics& self, std::size_t group, const Reals& state) {
            self.group(group).restore(readable(state));
          },
          py::arg("group"), py::arg("state").noconvert());
}

}  // namespace

void bind_pbd(py::module_& m) {
  bind_dynamics<float>(m, "ConstraintGroup32", "PositionBasedDynamics32");
  bind_dynamics<double>(m, "ConstraintGroup64", "PositionBasedDynamics64");
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
