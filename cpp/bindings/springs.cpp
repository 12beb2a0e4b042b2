#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/core/errors.h"
#include "substep/core/simulation.h"
#include "substep/geometry/kept_colliders.h"
#include "substep/springs/deformable.h"
#include "substep/springs/drag_term.h"
#include "substep/springs/newton_minimiser.h"
#include "substep/springs/projective_minimiser.h"
#include "substep/springs/spring_term.h"

namespace {

using namespace substep::springs;
using substep::geometry::Collider;

using Flags = py::array_t<std::uint8_t, py::array::c_style>;

static_assert(sizeof(Vec3) == 3 * sizeof(double));

Positions rows(const Reals& a) {
  return {reinterpret_cast<const Vec3*>(a.data()), static_cast<std::size_t>(a.shape(0))};
}

// The body, and the colliders of Python that it moves and that are read before each step.
class Body final : public substep::Simulation {
 public:
  template <class... Arguments>
  explicit Body(std::vector<std::shared_ptr<Collider>> colliders, Arguments&&... arguments)
      : body(std::forward<Arguments>(arguments)...), colliders_(std::move(colliders)) {}

  void step(double h) override {
    for (std::size_t c = 0; c < colliders_.size(); ++c) body.contacts.colliders[c] = *colliders_[c];
    body.step(h);
    for (std::size_t c = 0; c < colliders_.size(); ++c) *colliders_[c] = body.contacts.colliders[c];
  }
  double time() const override { return body.time; }
  void set_time(double time) override { body.time = time; }
  void keep() override {
    kept_time_ = body.time;
    for (std::size_t k = 0; k < kept_.size(); ++k) kept_[k] = *arrays()[k];
    kept_colliders_.keep(colliders_);
  }
  // Copies the numbers: the vectors have views.
  void rewind() override {
    body.time = kept_time_;
    for (std::size_t k = 0; k < kept_.size(); ++k)
      std::copy(kept_[k].begin(), kept_[k].end(), arrays()[k]->begin());
    kept_colliders_.rewind(colliders_);
  }
  std::vector<double> positions() const override { return flat(body.positions); }
  std::vector<double> velocities() const override { return flat(body.velocities); }

  Deformable body;

 private:
  std::array<std::vector<Vec3>*, 4> arrays() {
    return {&body.positions, &body.velocities, &body.forces, &body.targets};
  }
  static std::vector<double> flat(const std::vector<Vec3>& rows) {
    const auto* numbers = reinterpret_cast<const double*>(rows.data());
    return {numbers, numbers + 3 * rows.size()};
  }

  std::vector<std::shared_ptr<Collider>> colliders_;
  double kept_time_ = 0;  // and what follows: see keep()
  std::array<std::vector<Vec3>, 4> kept_;
  substep::geometry::KeptColliders kept_colliders_;
};

Integrator integrator(const std::string& name) {
  if (name == "explicit_euler") return Integrator::explicit_euler;
  if (name == "semi_implicit_euler") return Integrator::semi_implicit_euler;
  if (name == "rk4") return Integrator::rk4;
  if (name == "velocity_verlet") return Integrator::velocity_verlet;
  if (name == "implicit_euler") return Integrator::implicit_euler;
  throw substep::InputError("integrator: unknown name " + name);
}

std::unique_ptr<Minimiser> minimiser(const std::string& solver, int max_iterations) {
  if (solver == "newton") return std::make_unique<NewtonMinimiser>(max_iterations);
  if (solver == "projective") return std::make_unique<ProjectiveMinimiser>(max_iterations);
  throw substep::InputError("solver: unknown name " + solver);
}

// A view of one vector per vertex that keeps the body alive.
template <class Get>
auto view(Get get) {
  return [get](const py::object& self) {
    std::vector<Vec3>& values = get(self.cast<Body&>().body);
    return py::array_t<double>({static_cast<py::ssize_t>(values.size()), py::ssize_t{3}},
                               reinterpret_cast<double*>(values.data()), self);
  };
}

void bind_terms(py::module_& m) {
  py::class_<Term, std::shared_ptr<Term>>(m, "Term");
  m.def(
      "spring_terms",
      [](const Indices& edges, const Reals& stiffness, const Reals& rest_lengths,
         const Reals& damping) {
        auto springs = std::make_shared<Springs>(
            Springs{list(edges), list(stiffness), list(rest_lengths), list(damping)});
        std::vector<std::shared_ptr<Term>> terms = {std::make_shared<SpringTerm>(springs)};
        if (damping.size() > 0) terms.push_back(std::make_shared<SpringDampingTerm>(springs));
        return terms;
      },
      py::arg("edges").noconvert(), py::arg("stiffness").noconvert(),
      py::arg("rest_lengths").noconvert(), py::arg("damping").noconvert());
  m.def(
      "drag_term",
      [](double rate, const Reals& masses) -> std::shared_ptr<Term> {
        return std::make_shared<DragTerm>(rate, std::span(masses.data(), masses.size()));
      },
      py::arg("rate"), py::arg("masses").noconvert());
}

void bind_deformable(py::module_& m) {
  py::class_<StepReport>(m, "StepReport")
      .def_readonly("converged", &StepReport::converged)
      .def_readonly("friction_converged", &StepReport::friction_converged)
      .def_readonly("iterations", &StepReport::iterations)
      .def_readonly("factorizations", &StepReport::factorizations)
      .def_readonly("backtracks", &StepReport::backtracks)
      .def_readonly("refinements", &StepReport::refinements)
      .def_readonly("minimisations", &StepReport::minimisations)
      .def_readonly("failed", &StepReport::failed)
      .def_readonly("residuals", &StepReport::residuals);
  py::class_<Body, substep::Simulation>(m, "Deformable")
      .def(py::init([](const Reals& positions, const Reals& velocities, const Reals& masses,
                       const Flags& pinned, const std::vector<std::shared_ptr<Term>>& terms,
                       const std::vector<std::shared_ptr<Collider>>& colliders,
                       const std::string& integrator_name, const std::string& solver,
                       int max_iterations, const Triple& gravity, double tolerance,
                       int max_halvings, double contact_thickness, double contact_stiffness,
                       double sticking_speed, int threads) {
             Contacts contacts;
             for (const auto& collider : colliders) contacts.colliders.push_back(*collider);
             contacts.thickness = contact_thickness;
             contacts.sticking_speed = sticking_speed;
             const DeformableOptions options{.integrator = integrator(integrator_name),
                                             .gravity = vector(gravity),
                                             .tolerance = tolerance,
                                             .max_halvings = max_halvings,
                                             .contact_stiffness = contact_stiffness,
                                             .threads = threads};
             return new Body(colliders, rows(positions), rows(velocities),
                             std::span(masses.data(), masses.size()),
                             std::span(pinned.data(), pinned.size()), terms, contacts,
                             minimiser(solver, max_iterations), options);
           }),
           py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
           py::arg("masses").noconvert(), py::arg("pinned").noconvert(), py::arg("terms"),
           py::arg("colliders"), py::arg("integrator"), py::arg("solver"),
           py::arg("max_iterations"), py::arg("gravity"), py::arg("tolerance"),
           py::arg("max_halvings"), py::arg("contact_thickness"), py::arg("contact_stiffness"),
           py::arg("sticking_speed"), py::arg("threads"))
      .def_property(
          "gravity", [](const Body& self) { return triple(self.body.options.gravity); },
          [](Body& self, const Triple& g) { self.body.options.gravity = vector(g); })
      .def_property_readonly("positions", view([](Deformable& d) -> auto& { return d.positions; }))
      .def_property_readonly("velocities",
                             view([](Deformable& d) -> auto& { return d.velocities; }))
      .def_property_readonly("forces", view([](Deformable& d) -> auto& { return d.forces; }))
      .def_property_readonly("targets", view([](Deformable& d) -> auto& { return d.targets; }))
      .def_property(
          "pinned",
          [](const Body& self) {
            return Flags(static_cast<py::ssize_t>(self.body.pinned().size()),
                         self.body.pinned().data());
          },
          [](Body& self, const Flags& pinned) {
            self.body.set_pinned(std::span(pinned.data(), pinned.size()));
          })
      .def_property("time", &Body::time, &Body::set_time)
      .def_property(
          "threads", [](const Body& self) { return self.body.options.threads; },
          [](Body& self, int threads) { self.body.set_threads(threads); })
      .def_property_readonly("report", [](const Body& self) { return self.body.report(); })
      .def("step", &Body::step, py::arg("dt"), py::call_guard<py::gil_scoped_release>())
      .def("pattern",
           [](const Body& self) {
             const BlockPattern& lower = self.body.pattern();
             return std::pair(column(lower.columns), column(lower.rows));
           })
      .def(
          "assemble",
          [](Body& self, double dt, Reals values) {
            const auto size = static_cast<std::size_t>(values.size());
            if (size != self.body.pattern().rows.size()) {
              throw substep::InputError("values: expected one for each entry of pattern()");
            }
            const std::span<double> out(values.mutable_data(), size);
            const py::gil_scoped_release released;
            self.body.assemble(dt, out);
          },
          py::arg("dt"), py::arg("values").noconvert())
      .def("kinetic_energy", [](const Body& self) { return self.body.kinetic_energy(); })
      .def("potential_energy", [](const Body& self) { return self.body.potential_energy(); })
      .def("closest", [](const Body& self) { return self.body.closest().distance; })
      .def(
          "spectrum",
          [](const Body& self) {
            const Spectrum spectrum = self.body.spectrum();
            return std::pair(spectrum.frequency, spectrum.damping_rate);
          },
          py::call_guard<py::gil_scoped_release>());
}

// The factorizations that implicit steps use.
template <class Real>
void bind_factor(py::module_& m, const char* name) {
  using Factor = substep::SupernodalCholesky<Real>;
  py::class_<Factor>(m, name)
      .def(py::init([](const Indices& start, const Indices& row, int block) {
             const auto n = static_cast<std::int32_t>(start.size() - 1);
             return new Factor({n, n, list(start), list(row)}, block);
           }),
           py::arg("start").noconvert(), py::arg("row").noconvert(), py::arg("block"))
      .def(
          "factorize",
          [](Factor& self, const Reals& values, int threads) {
            const auto size = static_cast<std::size_t>(values.size());
            const std::span<const double> held(values.data(), size);
            const py::gil_scoped_release released;
            return self.factorize(held, threads);
          },
          py::arg("values").noconvert(), py::arg("threads"))
      .def(
          "solve",
          [](Factor& self, Reals x, int threads) {
            const std::span<double> out(x.mutable_data(), static_cast<std::size_t>(x.size()));
            const py::gil_scoped_release released;
            self.solve(out, threads);
          },
          py::arg("x").noconvert(), py::arg("threads"))
      .def_property_readonly("nonzeros", &Factor::nonzeros)
      .def_property_readonly("flops", &Factor::flops);
}

}  // namespace

void bind_springs(py::module_& m) {
  bind_factor<double>(m, "SupernodalCholesky");
  bind_factor<float>(m, "SingleSupernodalCholesky");
  bind_terms(m);
  bind_deformable(m);
}
