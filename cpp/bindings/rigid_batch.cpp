#include <pybind11/stl.h>

#include <algorithm>
#include <limits>

#include "bindings.h"
#include "substep/rigid/batch.h"

namespace {

using namespace substep;
using namespace substep::rigid;

using Reals = py::array_t<double, py::array::c_style>;
using Numbers = py::array_t<std::int64_t, py::array::c_style>;

std::span<const std::int64_t> list(const Numbers& a) {
  return {a.data(), static_cast<std::size_t>(a.size())};
}

// Rows of every body of every world, NaN where a world has fewer bodies: row(bodies, i, out).
template <class Row>
Reals gather(const Batch& batch, py::ssize_t columns, const Row& row) {
  const std::int64_t most = batch.most_bodies();
  Reals values({py::ssize_t{batch.size()}, py::ssize_t{most}, columns});
  double* out = values.mutable_data();
  const ReleaseGil nogil;
  std::fill_n(out, values.size(), std::numeric_limits<double>::quiet_NaN());
  for (std::int64_t w = 0; w < batch.size(); ++w) {
    const Bodies& bodies = batch.world(w).bodies();
    for (std::int64_t i = 0; i < bodies.size(); ++i) row(bodies, i, out + (w * most + i) * columns);
  }
  return values;
}

auto rows(std::vector<double> Bodies::* member, std::int64_t columns) {
  return [=](const Batch& batch) {
    return gather(batch, columns, [=](const Bodies& bodies, std::int64_t i, double* out) {
      std::copy_n(&(bodies.*member)[static_cast<std::size_t>(columns * i)], columns, out);
    });
  };
}

// Calls write(world, body, k) for the k-th of the listed bodies of the listed worlds.
template <class Write>
void scatter(Batch& batch, const Numbers& worlds, const Numbers& bodies, const Write& write) {
  std::size_t k = 0;
  for (const std::int64_t w : list(worlds)) {
    for (const std::int64_t i : list(bodies)) {
      if (i < batch.world(w).bodies().size()) write(batch.world(w), i, k);
      ++k;
    }
  }
}

auto set_rows(std::vector<double> Bodies::* member) {
  return [=](Batch& batch, const Numbers& worlds, const Numbers& bodies, const Reals& values) {
    scatter(batch, worlds, bodies, [&](World& world, std::int64_t i, std::size_t k) {
      std::copy_n(values.data() + 3 * k, 3,
                  &(world.bodies().*member)[static_cast<std::size_t>(3 * i)]);
    });
  };
}

Batch::Steps steps_of(double dt, std::int64_t count, bool hold_forces) {
  Batch::Steps steps;
  steps.dt = dt;
  steps.count = count;
  steps.hold_forces = hold_forces;
  return steps;
}

}  // namespace

void bind_rigid_batch(py::module_& m) {
  py::class_<Batch>(m, "RigidBatch")
      .def(py::init([](const std::vector<const World*>& worlds) {
             return new Batch(std::span(worlds));
           }),
           py::arg("worlds"))
      .def_readwrite("time", &Batch::time)
      .def_readwrite("threads", &Batch::threads)
      .def_readwrite("mask", &Batch::mask)
      .def("world", py::overload_cast<std::int64_t>(&Batch::world), py::arg("number"),
           py::return_value_policy::reference_internal)
      .def_property_readonly("failures",
                             [](const Batch& self) {
                               std::vector<std::string> failures;
                               for (std::int64_t w = 0; w < self.size(); ++w)
                                 failures.push_back(self.failure(w));
                               return failures;
                             })
      .def(
          "step",
          [](Batch& self, double dt, std::int64_t count, bool hold_forces) {
            const ReleaseGil nogil;
            self.step(steps_of(dt, count, hold_forces));
          },
          py::arg("dt"), py::arg("count") = 1, py::arg("hold_forces") = false)
      .def(
          "rollout",
          [](Batch& self, double dt, std::int64_t every, bool hold_forces, Reals& frames) {
            Batch::Steps steps = steps_of(dt, every * frames.shape(1), hold_forces);
            steps.frames = {{frames.mutable_data(), static_cast<std::size_t>(frames.size())},
                            frames.shape(1),
                            frames.shape(2),
                            frames.shape(3),
                            every};
            const ReleaseGil nogil;
            self.step(steps);
          },
          py::arg("dt"), py::arg("every"), py::arg("hold_forces"), py::arg("frames").noconvert())
      .def(
          "reset",
          [](Batch& self, const Numbers& worlds, const std::vector<const World*>& sources) {
            const ReleaseGil nogil;
            std::vector<WorldState> states;
            for (const World* source : sources) states.push_back(source->state());
            self.restore(list(worlds), states);
          },
          py::arg("worlds").noconvert(), py::arg("sources"))
      .def("times",
           [](const Batch& self) {
             Reals times(self.size());
             for (std::int64_t w = 0; w < self.size(); ++w)
               times.mutable_at(w) = self.world(w).time;
             return times;
           })
      .def("counts",
           [](const Batch& self) {
             Numbers counts(self.size());
             for (std::int64_t w = 0; w < self.size(); ++w)
               counts.mutable_at(w) = self.world(w).bodies().size();
             return counts;
           })
      .def("contact_counts",
           [](const Batch& self) {
             Numbers counts(self.size());
             for (std::int64_t w = 0; w < self.size(); ++w)
               counts.mutable_at(w) = static_cast<std::int64_t>(self.world(w).contacts().size());
             return counts;
           })
      .def("positions", rows(&Bodies::x, 3))
      .def("rotations", rows(&Bodies::q, 4))
      .def("momenta", rows(&Bodies::P, 3))
      .def("angular_momenta", rows(&Bodies::L, 3))
      .def("forces", rows(&Bodies::force, 3))
      .def("torques", rows(&Bodies::torque, 3))
      .def("velocities",
           [](const Batch& self) {
             return gather(self, 3, [](const Bodies& bodies, std::int64_t i, double* out) {
               Vec3::Map(out) = bodies.velocity(i);
             });
           })
      .def("angular_velocities",
           [](const Batch& self) {
             return gather(self, 3, [](const Bodies& bodies, std::int64_t i, double* out) {
               Vec3::Map(out) = bodies.angular_velocity(i);
             });
           })
      .def(
          "set_poses",
          [](Batch& self, const Numbers& worlds, const Numbers& bodies, const Reals& positions,
             const Reals& rotations) {
            scatter(self, worlds, bodies, [&](World& world, std::int64_t i, std::size_t k) {
              const auto row = static_cast<std::size_t>(i);
              std::copy_n(positions.data() + 3 * k, 3, &world.bodies().x[3 * row]);
              std::copy_n(rotations.data() + 4 * k, 4, &world.bodies().q[4 * row]);
            });
          },
          py::arg("worlds").noconvert(), py::arg("bodies").noconvert(),
          py::arg("positions").noconvert(), py::arg("rotations").noconvert())
      .def(
          "set_velocities",
          [](Batch& self, const Numbers& worlds, const Numbers& bodies, const Reals& velocities,
             const Reals& angular) {
            scatter(self, worlds, bodies, [&](World& world, std::int64_t i, std::size_t k) {
              if (world.bodies().motion[static_cast<std::size_t>(i)] == Motion::kStatic) return;
              world.bodies().set_velocity(i, Vec3(velocities.data() + 3 * k),
                                          Vec3(angular.data() + 3 * k));
            });
          },
          py::arg("worlds").noconvert(), py::arg("bodies").noconvert(),
          py::arg("velocities").noconvert(), py::arg("angular_velocities").noconvert())
      .def("set_forces", set_rows(&Bodies::force), py::arg("worlds").noconvert(),
           py::arg("bodies").noconvert(), py::arg("values").noconvert())
      .def("set_torques", set_rows(&Bodies::torque), py::arg("worlds").noconvert(),
           py::arg("bodies").noconvert(), py::arg("values").noconvert());
}
