#include <pybind11/stl.h>

#include "bindings.h"
#include "substep/core/errors.h"
#include "substep/mpm/solver/solver.h"

namespace {

using namespace substep::mpm;
using substep::geometry::Collider;

using Triple = std::array<double, 3>;

Vec3 vector(const Triple& a) { return {a[0], a[1], a[2]}; }
Triple triple(const Vec3& a) { return {a.x(), a.y(), a.z()}; }

template <class T>
using Array = py::array_t<T, py::array::c_style>;

AnyMaterial material(const std::string& kind, const py::dict& constants) {
  const auto c = [&](const char* name) { return constants[name].cast<double>(); };
  if (kind == NeoHookean::kName) return NeoHookean{c("density"), c("mu"), c("lambda")};
  if (kind == FixedCorotated::kName) return FixedCorotated{c("density"), c("mu"), c("lambda")};
  if (kind == Fluid::kName) {
    return Fluid{.density = c("density"),
                 .bulk_modulus = c("bulk_modulus"),
                 .viscosity = c("viscosity"),
                 .exponent = c("exponent"),
                 .tension = constants["tension"].cast<bool>()};
  }
  if (kind == Snow::kName) {
    return Snow{.density = c("density"),
                .mu = c("mu"),
                .lambda = c("lambda"),
                .critical_compression = c("critical_compression"),
                .critical_stretch = c("critical_stretch"),
                .hardening = c("hardening"),
                .largest_hardening = c("largest_hardening")};
  }
  if (kind == Sand::kName) {
    return Sand{.density = c("density"),
                .mu = c("mu"),
                .lambda = c("lambda"),
                .friction_angle = c("friction_angle"),
                .match = constants["match"].cast<std::string>() == "compression"
                             ? FrictionMatch::kCompression
                             : FrictionMatch::kPlaneStrain,
                .hardening_slope = c("hardening_slope"),
                .hardening_rate = c("hardening_rate"),
                .initial_softening = c("initial_softening")};
  }
  if (kind == VonMises::kName) {
    return VonMises{.density = c("density"),
                    .mu = c("mu"),
                    .lambda = c("lambda"),
                    .yield_stress = c("yield_stress"),
                    .hardening_modulus = c("hardening_modulus")};
  }
  if (kind == HerschelBulkley::kName) {
    return HerschelBulkley{.density = c("density"),
                           .mu = c("mu"),
                           .lambda = c("lambda"),
                           .yield_stress = c("yield_stress"),
                           .consistency = c("consistency"),
                           .flow_index = c("flow_index")};
  }
  throw substep::InputError("materials: there is no " + kind);
}

// Name, unit and initial value of the numbers that each kind of material keeps besides F, and
// whether it has an F: {kind: (has_F, [(name, unit, initial)])}.
template <class... Materials>
py::dict state_fields(const std::variant<Materials...>*) {
  py::dict all;
  const auto add = [&]<class M>(std::type_identity<M>) {
    py::list fields;
    for (const StateField& f : M::kState) fields.append(py::make_tuple(f.name, f.unit, f.initial));
    all[M::kName] = py::make_tuple(M::kHasF, fields);
  };
  (add(std::type_identity<Materials>{}), ...);
  return all;
}

// The solver, and the colliders of Python that it moves and that are read before each call.
template <class Real, int D>
struct Method {
  Solver<Real, D> solver;
  std::vector<std::shared_ptr<Collider>> colliders;

  // Runs steps; what was taken of them before one failed has moved the colliders too.
  template <class Steps>
  void run(const Steps& steps) {
    for (std::size_t c = 0; c < colliders.size(); ++c) solver.colliders()[c] = *colliders[c];
    try {
      steps();
    } catch (...) {
      write_colliders();
      throw;
    }
    write_colliders();
  }
  void write_colliders() {
    for (std::size_t c = 0; c < colliders.size(); ++c) *colliders[c] = solver.colliders()[c];
  }
};

Array<double> rows(const std::vector<double>& values, std::vector<py::ssize_t> shape) {
  Array<double> out(std::move(shape));
  std::copy(values.begin(), values.end(), out.mutable_data());
  return out;
}
template <class T>
Array<T> column(const std::vector<T>& values) {
  return Array<T>(static_cast<py::ssize_t>(values.size()), values.data());
}
std::vector<Vec3> embed(const Array<double>& values) {
  std::vector<Vec3> out(static_cast<std::size_t>(values.shape(0)), Vec3::Zero());
  for (py::ssize_t i = 0; i < values.shape(0); ++i) {
    for (py::ssize_t k = 0; k < values.shape(1); ++k) {
      out[static_cast<std::size_t>(i)][k] = values.at(i, k);
    }
  }
  return out;
}
template <class T>
std::span<const T> span(const Array<T>& values) {
  return {values.data(), static_cast<std::size_t>(values.size())};
}

template <class Real, int D>
py::dict state(const Method<Real, D>& self) {
  const Clock clock = self.solver.clock();
  std::vector<ParticleRows<Real, D>> groups;
  {
    const py::gil_scoped_release released;
    groups = self.solver.rows();
  }
  py::ssize_t n = 0, numbers = 0;
  std::vector<std::int64_t> counts;
  for (const auto& group : groups) {
    counts.push_back(static_cast<std::int64_t>(group.ids.size()));
    n += static_cast<py::ssize_t>(group.ids.size());
    numbers += static_cast<py::ssize_t>(group.state.size());
  }
  Array<std::int32_t> ids(n), blocks({n, py::ssize_t{D}});
  Array<Real> values(numbers), volumes(n),
      motion({n, py::ssize_t{ParticleGroup<Real, D>::kMotion}});
  std::int32_t *id = ids.mutable_data(), *block = blocks.mutable_data();
  Real *value = values.mutable_data(), *volume = volumes.mutable_data(), *v = motion.mutable_data();
  for (const auto& group : groups) {
    id = std::copy(group.ids.begin(), group.ids.end(), id);
    for (const auto& b : group.blocks) block = std::copy(b.begin(), b.end(), block);
    value = std::copy(group.state.begin(), group.state.end(), value);
    volume = std::copy(group.volume.begin(), group.volume.end(), volume);
    v = std::copy(group.motion.begin(), group.motion.end(), v);
  }
  const auto& f = self.solver.forces();
  Array<double> forces({static_cast<py::ssize_t>(f.size()), py::ssize_t{3}});
  for (std::size_t i = 0; i < f.size(); ++i) {
    std::copy_n(f[i].data(), 3, forces.mutable_data() + 3 * i);
  }
  return py::dict(py::arg("time") = clock.time, py::arg("supplied") = clock.supplied,
                  py::arg("drift") = clock.drift, py::arg("next_id") = clock.next_id,
                  py::arg("trial") = clock.trial, py::arg("before") = clock.before,
                  py::arg("counts") = column(counts), py::arg("ids") = ids,
                  py::arg("blocks") = blocks, py::arg("values") = values,
                  py::arg("motion") = motion, py::arg("volumes") = volumes,
                  py::arg("forces") = forces);
}

template <class Real, int D>
void restore(Method<Real, D>& self, const Clock& clock, const Array<std::int64_t>& counts,
             const Array<std::int32_t>& ids, const Array<std::int32_t>& blocks,
             const Array<Real>& values, const Array<Real>& motion, const Array<Real>& volumes,
             const Array<double>& forces) {
  const auto many = self.solver.options().materials.size();
  if (static_cast<std::size_t>(counts.size()) != many) {
    throw substep::InputError("state['counts']: expected one number per material");
  }
  std::int64_t n = 0, numbers = 0;
  for (std::size_t g = 0; g < many; ++g) {
    const std::int64_t count = counts.at(static_cast<py::ssize_t>(g));
    if (count < 0 || count > ids.size()) {
      throw substep::InputError("state['counts']: expected the numbers of the particles");
    }
    n += count;
    numbers += count * (D + self.solver.field_count(static_cast<int>(g)));
  }
  if (n != ids.size() || blocks.size() != n * D || values.size() != numbers ||
      motion.size() != n * ParticleGroup<Real, D>::kMotion || volumes.size() != n ||
      (forces.size() != 0 && forces.size() != 3 * n)) {
    throw substep::InputError("state: expected arrays of as many particles as there are ids");
  }
  std::vector<ParticleRows<Real, D>> groups(many);
  const std::int32_t *id = ids.data(), *block = blocks.data();
  const Real *value = values.data(), *v = motion.data(), *volume = volumes.data();
  for (std::size_t g = 0; g < many; ++g) {
    const auto count = counts.at(static_cast<py::ssize_t>(g));
    const auto width = count * (D + self.solver.field_count(static_cast<int>(g)));
    groups[g].ids.assign(id, id + count);
    for (std::int64_t i = 0; i < count; ++i, block += D) {
      substep::transfer::Index<D> at;
      std::copy_n(block, D, at.begin());
      groups[g].blocks.push_back(at);
    }
    groups[g].state.assign(value, value + width);
    groups[g].motion.assign(v, v + count * ParticleGroup<Real, D>::kMotion);
    groups[g].volume.assign(volume, volume + count);
    id += count, volume += count, value += width, v += count * ParticleGroup<Real, D>::kMotion;
  }
  self.solver.restore(clock, groups, forces.size() == 0 ? std::vector<Vec3>{} : embed(forces));
}

template <class Value>
Value choice(const std::string& name, std::initializer_list<std::pair<const char*, Value>> names) {
  for (const auto& [known, value] : names) {
    if (name == known) return value;
  }
  throw substep::InputError("options: there is no " + name);
}

Options options(const py::dict& given) {
  const auto word = [&](const char* name) { return given[name].cast<std::string>(); };
  const auto number = [&](const char* name) { return given[name].cast<double>(); };
  Options o;
  o.cell = number("cell");
  o.order = given["order"].cast<int>();
  o.transfer = choice<Transfer>(
      word("transfer"),
      {{"pic", Transfer::kPic}, {"flip", Transfer::kFlip}, {"apic", Transfer::kApic}});
  o.form = choice<Form>(word("form"), {{"mls", Form::kMls}, {"textbook", Form::kTextbook}});
  o.integrator = choice<Integrator>(word("integrator"), {{"explicit", Integrator::kExplicit},
                                                         {"implicit", Integrator::kImplicit}});
  o.flip_rate = number("flip_rate");
  o.gravity = vector(given["gravity"].cast<Triple>());
  o.cfl = number("cfl");
  o.largest = number("largest_step");
  o.step = number("step");  // 0: by the limits
  o.on_large_step =
      choice<OnLargeStep>(word("on_large_step"),
                          {{"raise", OnLargeStep::kRaise}, {"subdivide", OnLargeStep::kSubdivide}});
  o.on_escape = choice<OnEscape>(
      word("on_escape"),
      {{"raise", OnEscape::kRaise}, {"remove", OnEscape::kRemove}, {"clamp", OnEscape::kClamp}});
  for (const auto& [kind, constants] :
       given["materials"].cast<std::vector<std::pair<std::string, py::dict>>>()) {
    o.materials.push_back(material(kind, constants));
  }
  for (const auto& name : given["boundaries"].cast<std::vector<std::string>>()) {
    o.boundaries.push_back(choice<Boundary>(name, {{"sticky", Boundary::kSticky},
                                                   {"slip", Boundary::kSlip},
                                                   {"separate", Boundary::kSeparate}}));
  }
  if (!given["bounds"].is_none()) {
    const auto bounds = given["bounds"].cast<std::array<Triple, 2>>();
    o.bounds = {vector(bounds[0]), vector(bounds[1])};
  }
  return o;
}

template <class Real, int D>
void bind_method(py::module_& m, const char* name) {
  using M = Method<Real, D>;
  const auto per_particle = [](const std::vector<double>& values, std::vector<py::ssize_t> each) {
    py::ssize_t width = 1;
    for (const py::ssize_t k : each) width *= k;
    each.insert(each.begin(), static_cast<py::ssize_t>(values.size()) / width);
    return rows(values, each);
  };
  py::class_<M>(m, name)
      .def(py::init(
               [](const py::dict& given, const std::vector<std::shared_ptr<Collider>>& colliders) {
                 std::vector<Collider> copies;
                 for (const auto& collider : colliders) copies.push_back(*collider);
                 return new M{{options(given), std::move(copies)}, colliders};
               }),
           py::arg("options"), py::arg("colliders"))
      .def(
          "add",
          [](M& self, const Array<double>& positions, const Array<double>& velocities,
             const Array<std::int32_t>& materials, const Array<double>& volumes) {
            const auto x = embed(positions), v = embed(velocities);
            const py::gil_scoped_release released;
            return self.solver.add(x, v, span(materials), span(volumes));
          },
          py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
          py::arg("materials").noconvert(), py::arg("volumes").noconvert())
      .def(
          "remove",
          [](M& self, const Array<std::int64_t>& places) {
            std::vector<std::uint8_t> flags(static_cast<std::size_t>(self.solver.size()));
            for (const std::int64_t place : span(places))
              flags[static_cast<std::size_t>(place)] = 1;
            const py::gil_scoped_release released;
            self.solver.remove(flags);
          },
          py::arg("places").noconvert())
      .def(
          "absorb", [](M& self, const Collider& region) { return self.solver.absorb(region); },
          py::arg("region"), py::call_guard<py::gil_scoped_release>())
      .def(
          "step", [](M& self, double dt) { self.run([&] { self.solver.step(dt); }); },
          py::arg("dt"), py::call_guard<py::gil_scoped_release>())
      .def(
          "advance",
          [](M& self, double duration) { self.run([&] { self.solver.advance(duration); }); },
          py::arg("duration"), py::call_guard<py::gil_scoped_release>())
      .def("step_limit",
           [](const M& self) {
             StepLimit limit;
             {
               const py::gil_scoped_release released;
               limit = self.solver.step_limit();
             }
             return py::make_tuple(limit.dt, limit.reason);
           })
      .def("__len__", [](const M& self) { return self.solver.size(); })
      .def_property(
          "time", [](const M& self) { return self.solver.time(); },
          [](M& self, double time) { self.solver.set_time(time); })
      .def_property(
          "threads", [](const M& self) { return self.solver.threads(); },
          [](M& self, int threads) { self.solver.set_threads(threads); })
      .def_property_readonly("report", [](const M& self) { return self.solver.report(); })
      .def(
          "diagnostics", [](const M& self) { return self.solver.diagnostics(); },
          py::call_guard<py::gil_scoped_release>())
      .def("ids", [](const M& self) { return column(self.solver.ids()); })
      .def("materials", [](const M& self) { return column(self.solver.materials()); })
      .def("positions", [=](const M& self) { return per_particle(self.solver.positions(), {D}); })
      .def("velocities", [=](const M& self) { return per_particle(self.solver.velocities(), {D}); })
      .def("affine", [=](const M& self) { return per_particle(self.solver.affine(), {D, D}); })
      .def("volumes", [=](const M& self) { return per_particle(self.solver.volumes(), {}); })
      .def(
          "material_fields",
          [=](const M& self, int of) {
            return per_particle(self.solver.material_fields(of), {self.solver.field_count(of)});
          },
          py::arg("material"))
      .def("stresses", [=](const M& self) { return per_particle(self.solver.stresses(), {6}); })
      .def("elastic_energies",
           [=](const M& self) { return per_particle(self.solver.elastic_energies(), {}); })
      .def(
          "set_positions",
          [](M& self, const Array<double>& values, const Array<std::int64_t>& places) {
            self.solver.set_positions(embed(values), span(places));
          },
          py::arg("values").noconvert(), py::arg("places").noconvert())
      .def(
          "set_velocities",
          [](M& self, const Array<double>& values, const Array<std::int64_t>& places) {
            self.solver.set_velocities(embed(values), span(places));
          },
          py::arg("values").noconvert(), py::arg("places").noconvert())
      .def(
          "set_affine",
          [](M& self, const Array<double>& values, const Array<std::int64_t>& places) {
            self.solver.set_affine(span(values), span(places));
          },
          py::arg("values").noconvert(), py::arg("places").noconvert())
      .def(
          "set_material_fields",
          [](M& self, int of, const Array<double>& values, const Array<std::int64_t>& places) {
            self.solver.set_material_fields(of, span(values), span(places));
          },
          py::arg("material"), py::arg("values").noconvert(), py::arg("places").noconvert())
      .def(
          "set_forces",
          [](M& self, const Array<double>& values, const Array<std::int64_t>& places) {
            self.solver.set_forces(embed(values), span(places));
          },
          py::arg("values").noconvert(), py::arg("places").noconvert())
      .def("state", &state<Real, D>)
      .def(
          "restore",
          [](M& self, const py::dict& from) {
            const Clock clock{.time = from["time"].cast<double>(),
                              .supplied = from["supplied"].cast<double>(),
                              .drift = from["drift"].cast<double>(),
                              .next_id = from["next_id"].cast<std::int64_t>(),
                              .trial = from["trial"].cast<bool>(),
                              .before = from["before"].cast<double>()};
            restore<Real, D>(
                self, clock, from["counts"].cast<Array<std::int64_t>>(),
                from["ids"].cast<Array<std::int32_t>>(), from["blocks"].cast<Array<std::int32_t>>(),
                from["values"].cast<Array<Real>>(), from["motion"].cast<Array<Real>>(),
                from["volumes"].cast<Array<Real>>(), from["forces"].cast<Array<double>>());
          },
          py::arg("state"));
}

}  // namespace

void bind_mpm(py::module_& m) {
  py::class_<Report>(m, "MaterialPointReport")
      .def_readonly("steps", &Report::steps)
      .def_readonly("sorts", &Report::sorts)
      .def_readonly("subdivided", &Report::subdivided)
      .def_readonly("dt", &Report::dt)
      .def_readonly("limit", &Report::limit)
      .def_readonly("removed", &Report::removed)
      .def_readonly("clamped", &Report::clamped)
      .def_readonly("newton", &Report::newton)
      .def_readonly("krylov", &Report::krylov);
  py::class_<Diagnostics>(m, "MaterialPointSums")
      .def_readonly("mass", &Diagnostics::mass)
      .def_readonly("kinetic", &Diagnostics::kinetic)
      .def_readonly("potential", &Diagnostics::potential)
      .def_readonly("elastic", &Diagnostics::elastic)
      .def_readonly("dissipated", &Diagnostics::dissipated)
      .def_property_readonly("momentum", [](const Diagnostics& s) { return triple(s.momentum); })
      .def_property_readonly("angular_momentum",
                             [](const Diagnostics& s) { return triple(s.angular_momentum); });
  m.def("material_state_fields",
        [] { return state_fields(static_cast<const AnyMaterial*>(nullptr)); });
  bind_method<float, 2>(m, "MaterialPointMethod2D32");
  bind_method<float, 3>(m, "MaterialPointMethod3D32");
  bind_method<double, 2>(m, "MaterialPointMethod2D64");
  bind_method<double, 3>(m, "MaterialPointMethod3D64");
}
