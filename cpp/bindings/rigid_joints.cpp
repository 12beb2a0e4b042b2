#include <pybind11/stl.h>

#include <tuple>

#include "rigid_world.h"
#include "substep/core/errors.h"
#include "substep/rigid/solver/joint.h"

namespace rigid_binding {
namespace {

// (type, target, stiffness, damping, most)
using MotorTuple = std::tuple<int, double, double, double, double>;

Joint::Motor motor(const MotorTuple& t) {
  return {static_cast<MotorType>(std::get<0>(t)), std::get<1>(t), std::get<2>(t), std::get<3>(t),
          std::get<4>(t)};
}
MotorTuple tuple(const Joint::Motor& m) {
  return {static_cast<int>(m.type), m.target, m.stiffness, m.damping, m.most};
}

// (rest, stiffness and damping of the twist, of the swing)
using SpringTuple = std::tuple<Triple, double, double, double, double>;

Joint::Spring spring(const SpringTuple& t) {
  return {.rest = Vec3(std::get<0>(t).data()),
          .twist_stiffness = std::get<1>(t),
          .swing_stiffness = std::get<3>(t),
          .twist_damping = std::get<2>(t),
          .swing_damping = std::get<4>(t)};
}
SpringTuple tuple(const Joint::Spring& s) {
  return {triple(s.rest), s.twist_stiffness, s.twist_damping, s.swing_stiffness, s.swing_damping};
}

// Between bodies as they are; `axis` of a distance is its point of b, `second` the axis of b of a
// universal joint.
Joint make_joint(JointType type, const Bodies& bodies, std::int32_t a, std::int32_t b,
                 const Vec3& anchor, const Vec3& axis, const Vec3& second) {
  switch (type) {
    case JointType::kBall:
      return make_ball(bodies, a, b, anchor, axis);
    case JointType::kHinge:
      return make_hinge(bodies, a, b, anchor, axis);
    case JointType::kSlider:
      return make_slider(bodies, a, b, anchor, axis);
    case JointType::kFixed:
      return make_fixed(bodies, a, b, anchor);
    case JointType::kDistance:
      return make_distance(bodies, a, b, anchor, axis);
    case JointType::kElastic:
      return make_elastic(bodies, a, b, anchor, axis);
    case JointType::kUniversal:
      return make_universal(bodies, a, b, anchor, axis, second);
  }
  throw substep::InputError("kind: unknown");
}

const Joint& joint_of(const PyWorld& self, std::int64_t row) {
  check_row(row, static_cast<std::int64_t>(self.world.joints().size()));
  return self.world.joints()[static_cast<std::size_t>(row)];
}

py::dict told(const PyWorld& self, std::int64_t row) {
  const Joint& joint = joint_of(self, row);
  const Bodies& bodies = self.world.bodies();
  const auto anchor = [&](std::int32_t body, const Joint::Frame& frame) {
    return triple(body < 0 ? frame.anchor : bodies.pose(body).to_world(frame.anchor));
  };
  py::dict values;
  values["kind"] = static_cast<int>(joint.type);
  values["a"] = joint.a;
  values["b"] = joint.b;
  values["coordinate"] = joint.coordinate;
  values["coordinates"] = joint_coordinates(joint, bodies);
  values["axis"] = triple(joint_axis(joint, bodies));
  values["speed"] = joint_speed(joint, bodies);
  values["effort"] = joint.effort;
  values["limits"] = std::pair(joint.lower, joint.upper);
  values["motor"] = tuple(joint.motor);
  values["spring"] = tuple(joint.spring);
  values["force"] = triple(joint.force);
  values["torque"] = triple(joint.torque);
  values["error"] = std::pair(joint.length_error, joint.angle_error);
  values["anchors"] = std::pair(anchor(joint.a, joint.in_a), anchor(joint.b, joint.in_b));
  return values;
}

}  // namespace

void bind_joints(py::class_<PyWorld>& world) {
  world
      .def(
          "add_joint",
          [](PyWorld& self, int kind, std::int32_t a, std::int32_t b, const Triple& anchor,
             const Triple& axis, const Triple& second, double lower, double upper, double cone,
             const MotorTuple& drive, const SpringTuple& turning, bool collide) {
            for (const std::int32_t row : {a, b})
              if (row != -1) check_row(row, self.world.bodies().size());
            Joint joint = make_joint(static_cast<JointType>(kind), self.world.bodies(), a, b,
                                     Vec3(anchor.data()), Vec3(axis.data()), Vec3(second.data()));
            joint.lower = lower, joint.upper = upper, joint.cone = cone;
            joint.motor = motor(drive);
            joint.spring = spring(turning);
            joint.collide = collide;
            self.world.add_joint(joint);
          },
          py::arg("kind"), py::arg("a"), py::arg("b"), py::arg("anchor"), py::arg("axis"),
          py::arg("second"), py::arg("lower"), py::arg("upper"), py::arg("cone"), py::arg("motor"),
          py::arg("spring"), py::arg("collide"))
      .def(
          "set_joint",
          [](PyWorld& self, std::int64_t row, double lower, double upper, const MotorTuple& drive,
             const SpringTuple& turning) {
            Joint joint = joint_of(self, row);
            joint.lower = lower, joint.upper = upper;
            joint.motor = motor(drive);
            joint.spring = spring(turning);
            self.world.set_joint(row, joint);
          },
          py::arg("row"), py::arg("lower"), py::arg("upper"), py::arg("motor"), py::arg("spring"))
      .def(
          "remove_joints",
          [](PyWorld& self, const Numbers& rows) {
            const auto count = static_cast<std::int64_t>(self.world.joints().size());
            self.world.remove_joints(rows_in(rows, count));
          },
          py::arg("rows"))
      .def("joint", &told, py::arg("row"))
      .def("joint_bodies", [](const PyWorld& self) {
        const auto joints = self.world.joints();
        Numbers bodies({static_cast<py::ssize_t>(joints.size()), py::ssize_t{2}});
        std::int64_t* out = bodies.mutable_data();
        for (const Joint& joint : joints) *out++ = joint.a, *out++ = joint.b;
        return bodies;
      });
}

}  // namespace rigid_binding
