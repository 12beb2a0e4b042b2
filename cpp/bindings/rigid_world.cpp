#include "rigid_world.h"

#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <string>

#include "substep/core/errors.h"
#include "substep/rigid/shapes/mass_properties.h"

namespace rigid_binding {

RowArrays PyWorld::take_arrays() {
  const auto now = arrays(world.bodies());
  RowArrays copies, taken;
  for (std::size_t k = 0; k < now.size(); ++k) copies[k] = *now[k];
  for (std::size_t k = 0; k < now.size(); ++k) {
    taken[k] = std::move(*now[k]);
    *now[k] = std::move(copies[k]);
  }
  return taken;
}

void PyWorld::put_arrays(RowArrays&& taken) {
  const auto now = arrays(world.bodies());
  for (std::size_t k = 0; k < now.size(); ++k) *now[k] = std::move(taken[k]);
}

constexpr double kByRule = std::numeric_limits<double>::quiet_NaN();

std::array<double, 5> numbers_of(const MaterialPair& pair) {
  return {pair.friction.value_or(kByRule), pair.static_friction.value_or(kByRule),
          pair.restitution.value_or(kByRule), pair.rolling.value_or(kByRule),
          pair.spinning.value_or(kByRule)};
}

MaterialPair material_pair(const std::string& a, const std::string& b,
                           const std::array<double, 5>& numbers) {
  const auto given = [&](std::size_t k) {
    return std::isnan(numbers[k]) ? std::nullopt : std::optional(numbers[k]);
  };
  return {a, b, given(0), given(1), given(2), given(3), given(4)};
}

namespace {

using Array4 = std::array<double, 4>;

// (shape, position, rotation, density, friction, restitution, rolling, spinning, group, mask,
// static friction, material)
using FixtureTuple = std::tuple<RigidShape, Triple, Array4, double, double, double, double, double,
                                std::uint32_t, std::uint32_t, double, std::string>;

Fixture fixture(const FixtureTuple& t) {
  return {.shape = std::get<0>(t).shape,
          .local = {vector(std::get<1>(t)), substep::load_quaternion(std::get<2>(t).data())},
          .friction = std::get<4>(t),
          .restitution = std::get<5>(t),
          .density = std::get<3>(t),
          .rolling = std::get<6>(t),
          .spinning = std::get<7>(t),
          .group = std::get<8>(t),
          .mask = std::get<9>(t),
          .static_friction = std::get<10>(t),
          .material = std::get<11>(t)};
}

WorldOptions world_options(const py::dict& given) {
  const char* const rotations[] = {"exact", "splitting", "quaternion"};
  WorldOptions options;
  options.gravity = vector(given["gravity"].cast<Triple>());
  options.contact.substeps = given["substeps"].cast<int>();
  options.contact.rotation = static_cast<FreeRotation>(
      std::find(std::begin(rotations), std::end(rotations), given["rotation"].cast<std::string>()) -
      std::begin(rotations));
  options.contact_margin = given["contact_margin"].cast<double>();
  options.sleeping = given["sleeping"].cast<bool>();
  options.continuous = given["continuous"].cast<bool>();
  return options;
}

void bind_shapes(py::module_& m) {
  py::class_<RigidShape>(m, "RigidShape")
      .def(py::init([](const std::string& kind, const std::map<std::string, double>& numbers) {
             return RigidShape{make_shape(kind, numbers)};
           }),
           py::arg("kind"), py::arg("numbers"))
      .def_static(
          "hull",
          [](const Rows& points) {
            std::vector<Vec3> rows;
            for (py::ssize_t i = 0; i < points.shape(0); ++i) rows.emplace_back(points.data(i, 0));
            const py::gil_scoped_release nogil;
            return RigidShape{std::make_shared<const ConvexHull>(rows)};
          },
          py::arg("points"))
      .def_static(
          "mesh",
          [](const Rows& vertices, const Integers& faces) {
            std::vector<Vec3> corners;
            for (py::ssize_t i = 0; i < vertices.shape(0); ++i)
              corners.emplace_back(vertices.data(i, 0));
            std::vector<std::array<std::int32_t, 3>> triangles;
            for (py::ssize_t i = 0; i < faces.shape(0); ++i)
              triangles.push_back({faces.at(i, 0), faces.at(i, 1), faces.at(i, 2)});
            const py::gil_scoped_release nogil;
            return RigidShape{std::make_shared<const TriangleMesh>(corners, triangles)};
          },
          py::arg("vertices"), py::arg("faces"))
      .def(
          "moments",
          [](const RigidShape& self, double density) { return moments(self.shape, density); },
          py::arg("density"), py::call_guard<py::gil_scoped_release>());
}

// Bodies alike at poses of their principal frames: all of them or none.
void add(PyWorld& self, const std::vector<FixtureTuple>& parts, int motion, double mass,
         const Rows& inertia, const Rows& x, const Rows& q, const Rows& v, const Rows& w) {
  std::vector<Fixture> fixtures;
  for (const FixtureTuple& part : parts) fixtures.push_back(fixture(part));
  std::vector<BodyState> bodies;
  for (py::ssize_t i = 0; i < x.shape(0); ++i) {
    bodies.push_back({.position = Vec3(x.data(i, 0)),
                      .rotation = substep::load_quaternion(q.data(i, 0)),
                      .velocity = Vec3(v.data(i, 0)),
                      .angular_velocity = Vec3(w.data(i, 0)),
                      .motion = static_cast<Motion>(motion)});
    if (bodies.back().motion == Motion::kDynamic)
      bodies.back().mass = mass, bodies.back().inertia = Vec3(inertia.data());
  }
  self.with_other_bodies([&] { self.world.add(bodies, fixtures); });
}

// set(bodies, row, values of the row) of bodies of which none is static.
template <class Set>
auto set_moving(const Set& set) {
  return [set](PyWorld& self, const Numbers& rows, const Rows& values) {
    Bodies& bodies = self.world.bodies();
    const auto which = self.bodies(rows);
    for (std::size_t k = 0; k < which.size(); ++k) {
      if (bodies.motion[static_cast<std::size_t>(which[k])] == Motion::kStatic)
        throw substep::InputError("ids[" + std::to_string(k) + "]: a static body has no velocity");
    }
    for (std::size_t k = 0; k < which.size(); ++k) set(bodies, which[k], Vec3(values.data(k, 0)));
  };
}

// A view of the k-th of the arrays.
auto view(std::size_t k, py::ssize_t columns) {
  return [=](const py::object& self) {
    auto& w = self.cast<PyWorld&>();
    auto owner = w.views.lock();
    if (!owner) {
      owner = std::make_shared<ViewOwner>(ViewOwner{self, {}});
      w.views = owner;
    }
    Bodies& bodies = w.world.bodies();
    return Rows({static_cast<py::ssize_t>(bodies.size()), columns},
                PyWorld::arrays(bodies)[k]->data(), py::cast(owner));
  };
}

// One vector for each body.
template <class Get>
auto each_body(Get get) {
  return [get](const PyWorld& self) {
    const Bodies& bodies = self.world.bodies();
    Rows rows({static_cast<py::ssize_t>(bodies.size()), py::ssize_t{3}});
    for (std::int64_t i = 0; i < bodies.size(); ++i)
      Vec3::Map(rows.mutable_data(i, 0)) = get(bodies, i);
    return rows;
  };
}

constexpr double kInfinite = std::numeric_limits<double>::infinity();

void bind_rows(py::class_<PyWorld>& world) {
  world.def_property_readonly("positions", view(0, 3))
      .def_property_readonly("rotations", view(1, 4))
      .def_property_readonly("momenta", view(2, 3))
      .def_property_readonly("angular_momenta", view(3, 3))
      .def_property_readonly("forces", view(4, 3))
      .def_property_readonly("torques", view(5, 3))
      .def("velocities",
           each_body([](const Bodies& bodies, std::int64_t i) { return bodies.velocity(i); }))
      .def("angular_velocities", each_body([](const Bodies& bodies, std::int64_t i) {
             return bodies.angular_velocity(i);
           }))
      .def("inertia", each_body([](const Bodies& bodies, std::int64_t i) -> Vec3 {
             if (!bodies.dynamic(i)) return Vec3::Constant(kInfinite);
             return Vec3(&bodies.inertia[3 * static_cast<std::size_t>(i)]);
           }))
      .def("masses",
           [](const PyWorld& self) {
             const Bodies& bodies = self.world.bodies();
             py::array_t<double> masses(static_cast<py::ssize_t>(bodies.size()));
             for (std::int64_t i = 0; i < bodies.size(); ++i)
               masses.mutable_at(i) =
                   bodies.dynamic(i) ? bodies.mass[static_cast<std::size_t>(i)] : kInfinite;
             return masses;
           })
      .def("motions", [](const PyWorld& self) { return motions_of(self.world.bodies()); })
      .def("asleep", [](const PyWorld& self) {
        const std::int64_t n = self.world.bodies().size();
        py::array_t<std::uint8_t> flags(static_cast<py::ssize_t>(n));
        for (std::int64_t i = 0; i < n; ++i) flags.mutable_at(i) = self.world.asleep(i);
        return flags;
      });
}

void bind_changes(py::class_<PyWorld>& world) {
  world
      .def("add", &add, py::arg("fixtures"), py::arg("motion"), py::arg("mass"), py::arg("inertia"),
           py::arg("positions"), py::arg("rotations"), py::arg("velocities"),
           py::arg("angular_velocities"))
      .def(
          "remove",
          [](PyWorld& self, const Numbers& rows) {
            const auto which = self.bodies(rows);
            self.with_other_bodies([&] { self.world.remove(which); });
          },
          py::arg("rows"))
      .def(
          "exclude",
          [](PyWorld& self, std::int32_t a, std::int32_t b, bool excluded) {
            for (const std::int32_t row : {a, b}) check_row(row, self.world.bodies().size());
            self.world.exclude(a, b, excluded);
          },
          py::arg("a"), py::arg("b"), py::arg("excluded"))
      .def(
          "set_material_pair",
          [](PyWorld& self, const std::string& a, const std::string& b,
             const std::array<double, 5>& numbers) {
            self.world.set_material_pair(material_pair(a, b, numbers));
          },
          py::arg("a"), py::arg("b"), py::arg("numbers"))
      .def("material_pairs",
           [](const PyWorld& self) {
             std::vector<std::tuple<std::string, std::string, std::array<double, 5>>> pairs;
             for (const MaterialPair& pair : self.world.material_pairs())
               pairs.emplace_back(pair.a, pair.b, numbers_of(pair));
             return pairs;
           })
      .def(
          "set_motion",
          [](PyWorld& self, const Numbers& rows, int motion, const Rows& weights) {
            const auto which = self.bodies(rows);
            World changed(self.world);
            for (std::size_t k = 0; k < which.size(); ++k)
              changed.set_motion(which[k], static_cast<Motion>(motion), weights.at(k, 0),
                                 Vec3(weights.data(k, 1)));
            self.with_same_bodies([&] { self.world = std::move(changed); });
          },
          py::arg("rows"), py::arg("motion"), py::arg("weights"))
      .def("set_velocities", set_moving([](Bodies& bodies, std::int64_t i, const Vec3& v) {
             bodies.set_velocity(i, v);
           }),
           py::arg("rows"), py::arg("velocities"))
      .def("set_angular_velocities", set_moving([](Bodies& bodies, std::int64_t i, const Vec3& w) {
             bodies.set_angular_velocity(i, w);
           }),
           py::arg("rows"), py::arg("angular_velocities"))
      .def(
          "set_poses",
          [](PyWorld& self, const Numbers& rows, const Rows& x, const Rows& q) {
            Bodies& bodies = self.world.bodies();
            const auto which = self.bodies(rows);
            for (std::size_t k = 0; k < which.size(); ++k) {
              const auto i = static_cast<std::size_t>(which[k]);
              std::copy_n(x.data(k, 0), 3, &bodies.x[3 * i]);
              std::copy_n(q.data(k, 0), 4, &bodies.q[4 * i]);
            }
          },
          py::arg("rows"), py::arg("positions"), py::arg("rotations"))
      .def(
          "apply_forces",
          [](PyWorld& self, const Numbers& rows, const Rows& F, const Rows& points) {
            const auto which = self.bodies(rows);
            for (std::size_t k = 0; k < which.size(); ++k)
              self.world.bodies().apply_force(which[k], Vec3(F.data(k, 0)),
                                              Vec3(points.data(k, 0)));
          },
          py::arg("rows"), py::arg("forces"), py::arg("points"))
      .def(
          "apply_impulses",
          [](PyWorld& self, const Numbers& rows, const Rows& J, const Rows& points) {
            const auto which = self.bodies(rows);
            for (std::size_t k = 0; k < which.size(); ++k)
              self.world.bodies().apply_impulse(which[k], Vec3(J.data(k, 0)),
                                                Vec3(points.data(k, 0)));
          },
          py::arg("rows"), py::arg("impulses"), py::arg("points"))
      .def(
          "wake",
          [](PyWorld& self, const Numbers& rows) {
            for (const std::int64_t row : self.bodies(rows)) self.world.wake(row);
          },
          py::arg("rows"));
}

}  // namespace
}  // namespace rigid_binding

void bind_rigid_world(py::module_& m) {
  using namespace rigid_binding;
  bind_shapes(m);
  py::class_<ViewOwner, std::shared_ptr<ViewOwner>>(m, "RigidViewOwner");
  py::class_<PyWorld> world(m, "RigidWorld");
  world
      .def(py::init([](const py::dict& options) {
             return std::make_unique<PyWorld>(PyWorld{World(world_options(options)), {}});
           }),
           py::arg("options"))
      .def_property(
          "time", [](const PyWorld& self) { return self.world.time; },
          [](PyWorld& self, double time) { self.world.time = time; })
      .def_property(
          "threads", [](const PyWorld& self) { return self.world.threads; },
          [](PyWorld& self, int threads) { self.world.threads = threads; })
      .def_property(
          "gravity", [](const PyWorld& self) { return triple(self.world.options().gravity); },
          [](PyWorld& self, const Triple& gravity) {
            WorldOptions options = self.world.options();
            options.gravity = vector(gravity);
            self.world.set_options(options);
            for (std::int64_t i = 0; i < self.world.bodies().size(); ++i) self.world.wake(i);
          })
      .def(
          "step", [](PyWorld& self, double dt) { self.world.step(dt); }, py::arg("dt"),
          py::call_guard<py::gil_scoped_release>())
      .def("state", [](const PyWorld& self) { return state_of(self.world.state()); })
      .def("restore", &restore_state, py::arg("state"));
  bind_rows(world);
  bind_changes(world);
  bind_joints(world);
  bind_queries(world);
  bind_rigid_batch(m);
}
