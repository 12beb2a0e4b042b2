#include <pybind11/stl.h>

#include <algorithm>
#include <limits>

#include "rigid_world.h"
#include "substep/rigid/world/batch.h"

namespace rigid_binding {
namespace {

// Rows of every body of every world, NaN where a world has fewer bodies: row(bodies, i, out).
template <class Row>
Rows gather(const Batch& batch, py::ssize_t columns, const Row& row) {
  const std::int64_t most = batch.most_bodies();
  Rows values({py::ssize_t{batch.size()}, py::ssize_t{most}, columns});
  double* out = values.mutable_data();
  const py::gil_scoped_release nogil;
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
  for (const std::int64_t w : numbers(worlds)) {
    for (const std::int64_t i : numbers(bodies)) {
      if (i < batch.world(w).bodies().size()) write(batch.world(w), i, k);
      ++k;
    }
  }
}

auto set_rows(std::vector<double> Bodies::* member) {
  return [=](Batch& batch, const Numbers& worlds, const Numbers& bodies, const Rows& values) {
    scatter(batch, worlds, bodies, [&](World& world, std::int64_t i, std::size_t k) {
      std::copy_n(values.data() + 3 * k, 3,
                  &(world.bodies().*member)[static_cast<std::size_t>(3 * i)]);
    });
  };
}

std::int64_t contact_count(const World& world) {
  return static_cast<std::int64_t>(world.contacts().size() + world.sleeping_contacts().size());
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
      .def(py::init([](const std::vector<const PyWorld*>& templates) {
             std::vector<const World*> worlds;
             for (const PyWorld* one : templates) {
               worlds.push_back(&one->world);
             }
             return new Batch(worlds);
           }),
           py::arg("templates"))
      .def_readwrite("time", &Batch::time)
      .def_readwrite("threads", &Batch::threads)
      .def_readwrite("mask", &Batch::mask)
      .def_property(
          "failures",
          [](const Batch& self) {
            std::vector<std::string> failures;
            for (std::int64_t w = 0; w < self.size(); ++w) failures.push_back(self.failure(w));
            return failures;
          },
          [](Batch& self, const std::vector<std::string>& failures) {
            for (std::int64_t w = 0; w < self.size(); ++w)
              self.set_failure(w, failures[static_cast<std::size_t>(w)]);
          })
      .def(
          "step",
          [](Batch& self, double dt, std::int64_t count, bool hold_forces) {
            const py::gil_scoped_release nogil;
            self.step(steps_of(dt, count, hold_forces));
          },
          py::arg("dt"), py::arg("count") = 1, py::arg("hold_forces") = false)
      .def(
          "rollout",
          [](Batch& self, double dt, std::int64_t every, bool hold_forces, Rows& frames) {
            Batch::Steps steps = steps_of(dt, every * frames.shape(1), hold_forces);
            steps.frames = {{frames.mutable_data(), static_cast<std::size_t>(frames.size())},
                            frames.shape(1),
                            frames.shape(2),
                            frames.shape(3),
                            every};
            const py::gil_scoped_release nogil;
            self.step(steps);
          },
          py::arg("dt"), py::arg("every"), py::arg("hold_forces"), py::arg("frames").noconvert())
      .def("keep_initial", &Batch::keep_initial, py::call_guard<py::gil_scoped_release>())
      .def(
          "reset",
          [](Batch& self, const Numbers& worlds) {
            const py::gil_scoped_release nogil;
            self.reset(numbers(worlds));
          },
          py::arg("worlds"))
      .def(
          "put",
          [](Batch& self, const Numbers& worlds, const std::vector<const PyWorld*>& sources) {
            const py::gil_scoped_release nogil;
            std::vector<WorldState> states;
            for (const PyWorld* source : sources) {
              states.push_back(source->world.state());
            }
            std::vector<const WorldState*> pointers;
            for (const WorldState& state : states) pointers.push_back(&state);
            self.restore(numbers(worlds), pointers);
          },
          py::arg("worlds"), py::arg("sources"))
      .def(
          "copy_out",
          [](const Batch& self, std::int64_t w, PyWorld& to) {
            const WorldState state = self.world(w).state();
            to.with_same_bodies([&] { to.world.restore(state); });
          },
          py::arg("world"), py::arg("to"))
      .def(
          "state",
          [](const Batch& self, std::int64_t w) { return state_of(self.world(w).state()); },
          py::arg("world"))
      .def(
          "initial_state",
          [](const Batch& self, std::int64_t w) { return state_of(self.initial(w)); },
          py::arg("world"))
      .def("diagnostics",
           [](const Batch& self) {
             double kinetic = 0, potential = 0;
             std::int64_t failed = 0, contacts = 0;
             for (std::int64_t w = 0; w < self.size(); ++w) {
               const World& world = self.world(w);
               kinetic += world.bodies().kinetic_energy();
               potential += world.bodies().potential_energy(world.options().gravity);
               contacts += contact_count(world);
               failed += !self.failure(w).empty();
             }
             py::dict values;
             values["worlds"] = static_cast<double>(self.size());
             values["failed"] = static_cast<double>(failed);
             values["kinetic_energy"] = kinetic;
             values["potential_energy"] = potential;
             values["contacts"] = static_cast<double>(contacts);
             return values;
           })
      .def_property(
          "times",
          [](const Batch& self) {
            Rows times(self.size());
            for (std::int64_t w = 0; w < self.size(); ++w) times.mutable_at(w) = self.world(w).time;
            return times;
          },
          [](Batch& self, const Rows& times) {
            for (std::int64_t w = 0; w < self.size(); ++w) self.world(w).time = times.at(w);
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
               counts.mutable_at(w) = contact_count(self.world(w));
             return counts;
           })
      .def("joint_coordinates",
           [](const Batch& self) {
             std::size_t most = 0;
             for (std::int64_t w = 0; w < self.size(); ++w)
               most = std::max(most, self.world(w).joints().size());
             Rows values({py::ssize_t{self.size()}, static_cast<py::ssize_t>(most)});
             double* out = values.mutable_data();
             std::fill_n(out, values.size(), std::numeric_limits<double>::quiet_NaN());
             for (std::int64_t w = 0; w < self.size(); ++w, out += most) {
               const auto joints = self.world(w).joints();
               for (std::size_t j = 0; j < joints.size(); ++j) out[j] = joints[j].coordinate;
             }
             return values;
           })
      .def(
          "set_motor_targets",
          [](Batch& self, const Numbers& worlds, std::int64_t joint, const Rows& targets) {
            for (py::ssize_t k = 0; k < worlds.size(); ++k) {
              World& world = self.world(worlds.at(k));
              Joint changed = world.joints()[static_cast<std::size_t>(joint)];
              changed.motor.target = targets.at(k);
              world.set_joint(joint, changed);
            }
          },
          py::arg("worlds"), py::arg("joint"), py::arg("targets"))
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
          [](Batch& self, const Numbers& worlds, const Numbers& bodies, const Rows& positions,
             const Rows& rotations) {
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
          [](Batch& self, const Numbers& worlds, const Numbers& bodies, const Rows& velocities,
             const Rows& angular) {
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

}  // namespace rigid_binding
