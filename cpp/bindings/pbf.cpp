#include <pybind11/stl.h>

#include "bindings.h"
#include "substep/core/errors.h"
#include "substep/pbf/fluid.h"

namespace {

using namespace substep::pbf;
using substep::Point;
using substep::geometry::Collider;

using Triple = std::array<double, 3>;

Vec3 vector(const Triple& a) { return {a[0], a[1], a[2]}; }
Triple triple(const Vec3& a) { return {a.x(), a.y(), a.z()}; }

template <class T>
using Array = py::array_t<T, py::array::c_style>;

// The fluid, and the colliders of Python that it moves and that are read before each step.
template <class Real>
struct Liquid {
  Fluid<Real> fluid;
  std::vector<std::shared_ptr<Collider>> colliders;

  void read_colliders() {
    for (std::size_t c = 0; c < colliders.size(); ++c)
      fluid.boundary.colliders()[c] = *colliders[c];
  }
  void step(double dt) {
    read_colliders();
    fluid.step(dt);
    for (std::size_t c = 0; c < colliders.size(); ++c)
      *colliders[c] = fluid.boundary.colliders()[c];
  }
  int dimension() const { return fluid.options.density.dimension; }

  // Rows by ascending id.
  std::vector<std::int64_t> rows() const {
    const auto& ids = fluid.particles.id;
    std::vector<std::int64_t> row(static_cast<std::size_t>(fluid.next_id), -1);
    for (std::size_t i = 0; i < ids.size(); ++i) row[ids[i]] = static_cast<std::int64_t>(i);
    std::erase(row, -1);
    return row;
  }
};

template <class T, class Value>
Array<T> column(const std::vector<std::int64_t>& rows, const Value& value) {
  Array<T> out(static_cast<py::ssize_t>(rows.size()));
  T* to = out.mutable_data();
  for (const std::int64_t row : rows) *to++ = value(row);
  return out;
}
template <class Real, class Value>
Array<double> vectors(const Liquid<Real>& self, const Value& value) {
  const auto rows = self.rows();
  const int d = self.dimension();
  Array<double> out({static_cast<py::ssize_t>(rows.size()), static_cast<py::ssize_t>(d)});
  double* to = out.mutable_data();
  for (const std::int64_t row : rows) {
    const Vec3 v = value(row);
    to = std::copy_n(v.data(), d, to);
  }
  return out;
}

std::vector<Vec3> embed(const Array<double>& rows) {
  std::vector<Vec3> out(static_cast<std::size_t>(rows.shape(0)), Vec3::Zero());
  for (py::ssize_t i = 0; i < rows.shape(0); ++i) {
    for (py::ssize_t k = 0; k < rows.shape(1); ++k) out[i][k] = rows.at(i, k);
  }
  return out;
}

template <class Real>
Vec3 vector(const Point<Real>& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}

// Writes rows of `field` by their places in the order of ids.
template <class Real, class Write>
void write(Liquid<Real>& self, const Array<double>& values, const Array<std::int64_t>& places,
           const Write& put) {
  const auto rows = self.rows();
  const std::vector<Vec3> v = embed(values);
  for (py::ssize_t k = 0; k < places.size(); ++k) put(rows[places.at(k)], v[k]);
}

template <class Real>
Array<Real> raw(const std::vector<Point<Real>>& points) {
  return Array<Real>({static_cast<py::ssize_t>(points.size()), py::ssize_t{4}},
                     reinterpret_cast<const Real*>(points.data()));
}
template <class Real>
std::vector<Point<Real>> points(const Array<Real>& rows) {
  const auto* from = reinterpret_cast<const Point<Real>*>(rows.data());
  return {from, from + rows.shape(0)};
}

template <class Real>
py::dict state(const Liquid<Real>& self) {
  const Particles<Real>& p = self.fluid.particles;
  const auto n = static_cast<py::ssize_t>(p.size());
  return py::dict(py::arg("time") = self.fluid.time, py::arg("last_dt") = self.fluid.last_dt,
                  py::arg("next_id") = self.fluid.next_id, py::arg("positions") = raw(p.x),
                  py::arg("velocities") = raw(p.v), py::arg("forces") = raw(p.f),
                  py::arg("ids") = Array<std::int64_t>(n, p.id.data()),
                  py::arg("fluids") = Array<std::int32_t>(n, p.fluid.data()));
}

template <class Real>
void restore(Liquid<Real>& self, double time, double last_dt, std::int64_t next_id,
             const Array<Real>& positions, const Array<Real>& velocities, const Array<Real>& forces,
             const Array<std::int64_t>& ids, const Array<std::int32_t>& fluids) {
  self.fluid.particles = {.x = points(positions),
                          .v = points(velocities),
                          .f = points(forces),
                          .id = {ids.data(), ids.data() + ids.size()},
                          .fluid = {fluids.data(), fluids.data() + fluids.size()}};
  self.fluid.time = time;
  self.fluid.last_dt = last_dt;
  self.fluid.next_id = next_id;
  self.fluid.report = {};
}

FluidOptions options(const py::dict& given) {
  FluidOptions o;
  const auto kernel = given["kernel"].cast<std::string>();
  o.density = {.kernel = kernel == "cubic_spline" ? Kernel::kCubicSpline : Kernel::kPoly6Spiky,
               .dimension = given["dimension"].cast<int>(),
               .spacing = given["spacing"].cast<double>(),
               .support = given["support"].cast<double>(),
               .relaxation = given["relaxation"].cast<double>(),
               .artificial_pressure = given["artificial_pressure"].cast<double>(),
               .one_sided = given["one_sided"].cast<bool>()};
  o.forces = {.xsph = given["xsph"].cast<double>(),
              .viscosity = given["viscosity"].cast<std::vector<double>>(),
              .vorticity_confinement = given["vorticity_confinement"].cast<double>(),
              .surface_tension = given["surface_tension"].cast<double>()};
  o.masses = given["masses"].cast<std::vector<double>>();
  o.gravity = vector(given["gravity"].cast<Triple>());
  o.tolerance = given["tolerance"].cast<double>();
  o.max_tolerance = given["max_tolerance"].cast<double>();
  o.min_iterations = given["min_iterations"].cast<int>();
  o.max_iterations = given["max_iterations"].cast<int>();
  o.warm_start = given["warm_start"].cast<double>();
  const auto escape = given["on_escape"].cast<std::string>();
  o.on_escape = escape == "raise"    ? OnEscape::kRaise
                : escape == "remove" ? OnEscape::kRemove
                                     : OnEscape::kClamp;
  if (!given["bounds"].is_none()) {
    const auto bounds = given["bounds"].cast<std::array<Triple, 2>>();
    o.bounds = {vector(bounds[0]), vector(bounds[1])};
  }
  return o;
}

template <class Real>
void bind_liquid(py::module_& m, const char* name) {
  using L = Liquid<Real>;
  py::class_<L>(m, name)
      .def(
          py::init([](const Triple& origin, const std::vector<std::shared_ptr<Collider>>& colliders,
                      const py::dict& given) {
            std::vector<Collider> copies;
            for (const auto& collider : colliders) copies.push_back(*collider);
            return new L{{vector(origin), std::move(copies), options(given)}, colliders};
          }),
          py::arg("origin"), py::arg("colliders"), py::arg("options"))
      .def(
          "add",
          [](L& self, const Array<double>& positions, const Array<double>& velocities,
             const Array<std::int32_t>& fluids) {
            return self.fluid.add(embed(positions), embed(velocities),
                                  {fluids.data(), static_cast<std::size_t>(fluids.size())});
          },
          py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
          py::arg("fluids").noconvert())
      .def(
          "remove",
          [](L& self, const Array<std::int64_t>& places) {
            const auto rows = self.rows();
            std::vector<std::uint8_t> flags(rows.size());
            for (py::ssize_t k = 0; k < places.size(); ++k) flags[rows[places.at(k)]] = 1;
            self.fluid.remove(flags);
          },
          py::arg("places").noconvert())
      .def(
          "absorb", [](L& self, const Collider& region) { return self.fluid.absorb(region); },
          py::arg("region"), py::call_guard<py::gil_scoped_release>())
      .def("step", &L::step, py::arg("dt"), py::call_guard<py::gil_scoped_release>())
      .def("__len__", [](const L& self) { return self.fluid.particles.size(); })
      .def_property(
          "time", [](const L& self) { return self.fluid.time; },
          [](L& self, double time) { self.fluid.time = time; })
      .def_property(
          "threads", [](const L& self) { return self.fluid.options.threads; },
          [](L& self, int threads) { self.fluid.options.threads = threads; })
      .def_property_readonly("report", [](const L& self) { return self.fluid.report; })
      .def_property_readonly("energies", [](const L& self) { return self.fluid.energies(); })
      .def_property_readonly("fastest", [](const L& self) { return self.fluid.fastest(); })
      .def_property_readonly("volume", [](const L& self) { return self.fluid.density.volume(); })
      .def("ids",
           [](const L& self) {
             return column<std::int64_t>(
                 self.rows(), [&](std::int64_t i) { return self.fluid.particles.id[i]; });
           })
      .def("fluids",
           [](const L& self) {
             return column<std::int32_t>(
                 self.rows(), [&](std::int64_t i) { return self.fluid.particles.fluid[i]; });
           })
      .def("densities",
           [](L& self) {
             self.read_colliders();
             std::vector<Real> values;
             {
               const py::gil_scoped_release released;
               values = self.fluid.densities();
             }
             return column<double>(self.rows(), [&](std::int64_t i) { return values[i]; });
           })
      .def("positions",
           [](const L& self) {
             return vectors(
                 self, [&](std::int64_t i) { return self.fluid.world(self.fluid.particles.x[i]); });
           })
      .def("velocities",
           [](const L& self) {
             return vectors(self,
                            [&](std::int64_t i) { return vector(self.fluid.particles.v[i]); });
           })
      .def(
          "set_positions",
          [](L& self, const Array<double>& values, const Array<std::int64_t>& places) {
            self.fluid.check_reach(embed(values));
            write(self, values, places, [&](std::int64_t i, const Vec3& x) {
              self.fluid.particles.x[i] = self.fluid.local(x, self.fluid.particles.x[i].w);
            });
          },
          py::arg("values").noconvert(), py::arg("places").noconvert())
      .def(
          "set_velocities",
          [](L& self, const Array<double>& values, const Array<std::int64_t>& places) {
            write(self, values, places, [&](std::int64_t i, const Vec3& v) {
              Point<Real>& to = self.fluid.particles.v[i];
              to = {static_cast<Real>(v.x()), static_cast<Real>(v.y()), static_cast<Real>(v.z()),
                    to.w};
            });
          },
          py::arg("values").noconvert(), py::arg("places").noconvert())
      .def(
          "set_forces",
          [](L& self, const Array<double>& values, const Array<std::int64_t>& places) {
            self.fluid.particles.f.resize(self.fluid.particles.x.size());
            write(self, values, places, [&](std::int64_t i, const Vec3& f) {
              self.fluid.particles.f[i] = {static_cast<Real>(f.x()), static_cast<Real>(f.y()),
                                           static_cast<Real>(f.z()), 0};
            });
          },
          py::arg("values").noconvert(), py::arg("places").noconvert())
      .def("state", &state<Real>)
      .def("restore", &restore<Real>, py::arg("time"), py::arg("last_dt"), py::arg("next_id"),
           py::arg("positions").noconvert(), py::arg("velocities").noconvert(),
           py::arg("forces").noconvert(), py::arg("ids").noconvert(),
           py::arg("fluids").noconvert());
}

}  // namespace

void bind_pbf(py::module_& m) {
  py::class_<FluidReport>(m, "FluidReport")
      .def_readonly("iterations", &FluidReport::iterations)
      .def_readonly("converged", &FluidReport::converged)
      .def_readonly("limited", &FluidReport::limited)
      .def_property_readonly("viscosity_iterations",
                             [](const FluidReport& r) { return r.viscosity.iterations; })
      .def_property_readonly("viscosity_converged",
                             [](const FluidReport& r) { return r.viscosity.converged; })
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
  bind_liquid<float>(m, "PositionBasedFluid32");
  bind_liquid<double>(m, "PositionBasedFluid64");
}
