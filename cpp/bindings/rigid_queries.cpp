#include <pybind11/stl.h>

#include <algorithm>

#include "rigid_world.h"
#include "substep/rigid/solver/mobility.h"
#include "substep/rigid/world/queries.h"
#include "substep/rigid/world/supports.h"

namespace rigid_binding {
namespace {

Vec3 vec(const Rows& v) { return Vec3(v.data()); }
Pose pose(const Rows& x, const Rows& q) { return {vec(x), substep::load_quaternion(q.data())}; }

// (bodies, fixtures of these, distances, normals), -1 for none.
py::tuple tuple_of(const World& world, std::span<const FixtureHit> hits) {
  const auto n = static_cast<py::ssize_t>(hits.size());
  Numbers bodies(n), fixtures(n);
  py::array_t<double> distances(n);
  Rows normals({n, py::ssize_t{3}});
  for (py::ssize_t k = 0; k < n; ++k) {
    const FixtureHit& hit = hits[static_cast<std::size_t>(k)];
    const bool met = hit.fixture >= 0;
    const std::int64_t body = met ? world.fixtures()[hit.fixture].body : -1;
    bodies.mutable_at(k) = body;
    fixtures.mutable_at(k) = met ? hit.fixture - world.fixtures().first(body) : -1;
    distances.mutable_at(k) = hit.distance;
    Vec3::Map(normals.mutable_data(k, 0)) = met ? hit.normal : Vec3::Zero();
  }
  return py::make_tuple(bodies, fixtures, distances, normals);
}

py::tuple tuple_of(const World& world, const std::optional<FixtureHit>& hit) {
  const FixtureHit one = hit.value_or(FixtureHit{});
  return tuple_of(world, std::span(&one, 1));
}

// The fields of Contacts in python/substep/rigid/queries.py.
py::tuple contacts(const PyWorld& self) {
  const auto awake = self.world.contacts(), asleep = self.world.sleeping_contacts();
  std::vector<ContactConstraint> all(awake.begin(), awake.end());
  all.insert(all.end(), asleep.begin(), asleep.end());
  std::sort(all.begin(), all.end(), [](const ContactConstraint& c, const ContactConstraint& d) {
    return std::pair(c.fixture_a, c.fixture_b) < std::pair(d.fixture_a, d.fixture_b);
  });
  const auto m = static_cast<py::ssize_t>(all.size());
  py::ssize_t k = 0;
  for (const ContactConstraint& c : all) k += c.count;
  Numbers bodies({m, py::ssize_t{2}}), fixtures({m, py::ssize_t{2}}), contact(k);
  Rows normals({m, py::ssize_t{3}}), friction({m, py::ssize_t{3}}), points({k, py::ssize_t{3}});
  py::array_t<double> impulses(m), separations(k), point_impulses(k);
  k = 0;
  for (py::ssize_t i = 0; i < m; ++i) {
    const ContactConstraint& c = all[static_cast<std::size_t>(i)];
    bodies.mutable_at(i, 0) = c.a, bodies.mutable_at(i, 1) = c.b;
    fixtures.mutable_at(i, 0) = c.fixture_a - self.world.fixtures().first(c.a);
    fixtures.mutable_at(i, 1) = c.fixture_b - self.world.fixtures().first(c.b);
    Vec3::Map(normals.mutable_data(i, 0)) = c.normal;
    double sum = 0;
    for (int p = 0; p < c.count; ++p, ++k) {
      contact.mutable_at(k) = i;
      Vec3::Map(points.mutable_data(k, 0)) = c.points[p].position;
      separations.mutable_at(k) = c.points[p].separation;
      point_impulses.mutable_at(k) = c.points[p].total;
      sum += c.points[p].total;
    }
    impulses.mutable_at(i) = sum;
    Vec3::Map(friction.mutable_data(i, 0)) =
        c.friction_total[0] * c.tangent + c.friction_total[1] * c.normal.cross(c.tangent);
  }
  return py::make_tuple(bodies, fixtures, normals, impulses, friction, contact, points, separations,
                        point_impulses);
}

}  // namespace

void bind_queries(py::class_<PyWorld>& world) {
  world.def("contacts", &contacts)
      .def(
          "cast_rays",
          [](PyWorld& self, const Rows& x, const Rows& d, double length, std::uint32_t mask) {
            std::vector<Ray> rays;
            for (py::ssize_t k = 0; k < x.shape(0); ++k)
              rays.push_back({Vec3(x.data(k, 0)), Vec3(d.data(k, 0)), length});
            std::vector<FixtureHit> hits(rays.size());
            {
              const py::gil_scoped_release nogil;
              cast_rays(self.world.scene(), rays, mask, hits, self.world.threads);
            }
            return tuple_of(self.world, hits);
          },
          py::arg("origins"), py::arg("directions"), py::arg("length"), py::arg("mask"))
      .def(
          "cast_ray_through",
          [](PyWorld& self, const Rows& x, const Rows& d, double length, std::uint32_t mask) {
            const Ray ray{vec(x), vec(d), length};
            return tuple_of(self.world, cast_ray_through(self.world.scene(), ray, mask));
          },
          py::arg("origin"), py::arg("direction"), py::arg("length"), py::arg("mask"))
      .def(
          "cast_shape",
          [](PyWorld& self, const RigidShape& shape, const Rows& x, const Rows& q, const Rows& d,
             double length, std::uint32_t mask) {
            return tuple_of(self.world, cast_shape(self.world.scene(), shape.shape, pose(x, q),
                                                   vec(d), length, mask));
          },
          py::arg("shape"), py::arg("position"), py::arg("rotation"), py::arg("direction"),
          py::arg("length"), py::arg("mask"))
      .def(
          "overlapping",
          [](PyWorld& self, const RigidShape& shape, const Rows& x, const Rows& q,
             std::uint32_t mask) {
            std::vector<std::int64_t> bodies;
            for (const auto f : overlapping(self.world.scene(), shape.shape, pose(x, q), mask))
              bodies.push_back(self.world.fixtures()[f].body);
            return Numbers(static_cast<py::ssize_t>(bodies.size()), bodies.data());
          },
          py::arg("shape"), py::arg("position"), py::arg("rotation"), py::arg("mask"))
      .def("constrained",
           [](const PyWorld& self) {
             std::vector<std::int64_t> bodies;
             for (const ContactConstraint& c : self.world.contacts())
               for (const std::int32_t b : {c.a, c.b})
                 if (self.world.bodies().dynamic(b)) bodies.push_back(b);
             for (const Joint& joint : self.world.joints())
               for (const std::int32_t b : {joint.a, joint.b})
                 if (b >= 0 && self.world.bodies().dynamic(b)) bodies.push_back(b);
             std::sort(bodies.begin(), bodies.end());
             bodies.erase(std::unique(bodies.begin(), bodies.end()), bodies.end());
             return Numbers(static_cast<py::ssize_t>(bodies.size()), bodies.data());
           })
      .def(
          "mobilities",
          [](const PyWorld& self, const Numbers& rows, const Flags& held, double dt) {
            const std::span given(held.data(), static_cast<std::size_t>(held.size()));
            if (given.size() != self.world.joints().size())
              throw substep::InputError("held: expected a number for each joint");
            const std::vector<Mat6> found =
                mobilities(self.world.bodies(), self.world.joints(), given, self.bodies(rows), dt);
            py::array_t<double> out(
                {static_cast<py::ssize_t>(found.size()), py::ssize_t{6}, py::ssize_t{6}});
            for (std::size_t k = 0; k < found.size(); ++k)
              Eigen::Map<Mat6>{out.mutable_data(static_cast<py::ssize_t>(k), 0, 0)} = found[k];
            return out;
          },
          py::arg("rows"), py::arg("held"), py::arg("dt"))
      .def("parts_of_strength",
           [](const PyWorld& self) {
             const std::vector<double> parts = parts_of_strength(self.world.joints());
             return py::array_t<double>(static_cast<py::ssize_t>(parts.size()), parts.data());
           })
      .def("supported",
           [](const PyWorld& self) {
             const std::vector<std::uint8_t> held = supported_bodies(self.world);
             return py::array_t<std::uint8_t>(static_cast<py::ssize_t>(held.size()), held.data());
           })
      .def("diagnostics", [](const PyWorld& self) {
        const Bodies& bodies = self.world.bodies();
        double penetration = 0, contacts = 0;
        const auto count = [&](const ContactConstraint& c) {
          bool touch = false;
          for (int k = 0; k < c.count; ++k) {
            penetration = std::max(penetration, -c.points[k].separation);
            touch = touch || c.points[k].separation <= 0 || c.points[k].impulse > 0;
          }
          contacts += touch;
        };
        for (const ContactConstraint& c : self.world.contacts()) count(c);
        for (const ContactConstraint& c : self.world.sleeping_contacts()) count(c);
        double awake = 0;
        for (std::int32_t i = 0; i < bodies.size(); ++i)
          awake += bodies.dynamic(i) && !self.world.asleep(i);
        py::dict values;
        values["count"] = static_cast<double>(bodies.size());
        values["kinetic_energy"] = bodies.kinetic_energy();
        values["potential_energy"] = bodies.potential_energy(self.world.options().gravity);
        const Vec3 p = bodies.momentum(), l = bodies.angular_momentum();
        values["momentum_x"] = p.x(), values["momentum_y"] = p.y(), values["momentum_z"] = p.z();
        values["angular_momentum_x"] = l.x(), values["angular_momentum_y"] = l.y();
        values["angular_momentum_z"] = l.z();
        values["contacts"] = contacts;
        values["penetration"] = penetration;
        values["impacts"] = static_cast<double>(self.world.impacts());
        values["awake"] = awake;
        double error = 0;
        for (const Joint& joint : self.world.joints())
          error = std::max({error, joint.length_error, joint.angle_error});
        values["joint_error"] = error;
        return values;
      });
}

}  // namespace rigid_binding
