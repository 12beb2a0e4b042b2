// The equations of joints against finite differences, the factorization against a dense one, and
// what is refused.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <array>
#include <functional>
#include <random>
#include <string>

#include "joint_scene.h"
#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/rigid/solver/joint_matrix.h"
#include "substep/rigid/solver/joint_rows.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::rigid;

TEST(JointRows, HaveTheGradientsOfFiniteDifferences) {
  std::mt19937 random(2);
  std::normal_distribution<> normal;
  const auto vector = [&] { return Vec3(normal(random), normal(random), normal(random)); };
  using Side = std::pair<Vec3, Quaternion>;
  for (const JointType type :
       {JointType::kBall, JointType::kHinge, JointType::kSlider, JointType::kFixed,
        JointType::kDistance, JointType::kUniversal, JointType::kElastic}) {
    Side a{vector(), rotation_by(vector())}, b{vector(), rotation_by(vector())};
    Joint::Frame in_a{vector(), rotation_by(vector())}, in_b = in_a;
    // As joints are kept: aligned axes, but for the free angles; anchors at one point, but for the
    // free lengths.
    const Quaternion axes = a.second * in_a.axes;
    Quaternion turn = Quaternion::Identity();
    if (type == JointType::kBall || type == JointType::kElastic) turn = rotation_by(0.5 * vector());
    if (type == JointType::kHinge) turn = rotation_by({1, 0, 0});
    if (type == JointType::kUniversal) turn = rotation_by({0, -0.6, 0}) * rotation_by({1, 0, 0});
    in_b.axes = b.second.conjugate() * axes * turn.conjugate();
    Vec3 gap = Vec3::Zero();
    if (type == JointType::kSlider) gap = axes * Vec3(0.7, 0, 0);
    if (type == JointType::kDistance) gap = vector();
    in_b.anchor = b.second.conjugate() * (a.first + a.second * in_a.anchor - gap - b.first);
    const auto values = [&](const Side& at_a, const Side& at_b) {
      JointLanes lanes[kJointRows] = {};
      joint_values(type, JointSides(in_a, at_a.first, at_a.second),
                   JointSides(in_b, at_b.first, at_b.second), JointLanes{}, true, lanes);
      std::array<double, kJointRows> C;
      for (int row = 0; row < kJointRows; ++row) C[usize(row)] = lanes[row][kJointLanes - 1];
      return C;
    };
    JointGradients G;
    joint_gradients(type, JointSides(in_a, a.first, a.second), JointSides(in_b, b.first, b.second),
                    G);
    const auto lane = [](const JointVector& v) { return Vec3(v[0][0], v[1][0], v[2][0]); };
    const Vec3 arm_a = lane(G.arm_a), arm_b = lane(G.arm_b);
    const int rows = type == JointType::kDistance ? 1 : type == JointType::kBall ? 5 : 6;
    const auto C = values(a, b);
    for (int row = 0; row < joint_equations(type); ++row) EXPECT_NEAR(C[usize(row)], 0, 1e-14);
    for (int trial = 0; trial < 5; ++trial) {
      const Vec3 va = vector(), wa = vector(), vb = vector(), wb = vector();
      const double e = 1e-6;
      const auto moved = [&](double s) {
        return values({a.first + s * va, rotation_by(s * wa) * a.second},
                      {b.first + s * vb, rotation_by(s * wb) * b.second});
      };
      const auto plus = moved(e), minus = moved(-e);
      for (int row = 0; row < rows; ++row) {
        const auto k = usize(row);
        const double rate =
            lane(G.axis[row])
                .dot(is_turn(type, row) ? Vec3(wa - wb)
                                        : Vec3(va + wa.cross(arm_a) - vb - wb.cross(arm_b)));
        EXPECT_NEAR((plus[k] - minus[k]) / (2 * e), rate, 1e-8) << static_cast<int>(type) << row;
      }
    }
  }
}

TEST(JointMatrix, SolvesTreesAndLoops) {
  std::mt19937 random(1);
  std::normal_distribution<> normal;
  for (int trial = 0; trial < 30; ++trial) {
    const int bodies = 1 + trial % 7;
    std::vector<BodyPair> joints;
    std::vector<int> rows;
    const auto add = [&](std::int32_t a, std::int32_t b) {
      joints.push_back({a, b});
      rows.push_back(1 + static_cast<int>(random() % 6));
    };
    for (std::int32_t k = 0; k < bodies; ++k)
      add(k, k > 0 ? static_cast<std::int32_t>(random() % static_cast<unsigned>(k)) : -1);
    if (bodies > 1 && trial % 2 == 0) add(0, bodies - 1);
    if (trial % 3 == 0) add(-1, bodies - 1);
    JointMatrix matrix;
    matrix.analyse(bodies, joints, rows);
    matrix.clear();
    int size = 0;
    for (const int r : rows) size += r;
    Eigen::MatrixXd G = Eigen::MatrixXd::Zero(size, 6 * bodies);
    Eigen::VectorXd E(size), c(size);
    std::vector<JointMatrix::Piece> x(joints.size());
    int at = 0;
    for (std::size_t j = 0; j < joints.size(); ++j) {
      x[j].fill(0);
      for (int r = 0; r < rows[j]; ++r, ++at) {
        JointMatrix::Piece a, b;
        for (double& entry : a) entry = normal(random);
        for (double& entry : b) entry = normal(random);
        if (joints[j].a >= 0)
          G.row(at).segment(6 * joints[j].a, 6) = Eigen::Map<Eigen::RowVectorXd>(a.data(), 6);
        if (joints[j].b >= 0)
          G.row(at).segment(6 * joints[j].b, 6) = Eigen::Map<Eigen::RowVectorXd>(b.data(), 6);
        E[at] = 1e-3;
        c[at] = x[j][usize(r)] = normal(random);
        matrix.set(static_cast<std::int32_t>(j), r, a, b, E[at]);
      }
    }
    matrix.factor();
    matrix.solve(x);
    Eigen::MatrixXd K = G * G.transpose();
    K.diagonal() += E;
    const Eigen::VectorXd l = K.ldlt().solve(-c);
    at = 0;
    for (std::size_t j = 0; j < joints.size(); ++j) {
      for (int r = 0; r < rows[j]; ++r, ++at)
        EXPECT_NEAR(x[j][usize(r)], l[at], 1e-9 * (1 + l.norm()));
    }
  }
}

TEST(Joints, RefuseWhatIsNoJoint) {
  Bodies bodies;
  bodies.add({});
  bodies.add({.position = {1, 0, 0}});
  bodies.add({.motion = Motion::kStatic});
  bodies.add({.motion = Motion::kKinematic});
  const auto refused = [](const std::function<void()>& call, const std::string& words) {
    try {
      call();
      ADD_FAILURE() << "accepted: " << words;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
    }
  };
  const double nan = std::nan("");
  const Vec3 o = Vec3::Zero(), x = Vec3::UnitX();
  refused([&] { make_ball(bodies, 4, 0, o); }, "a: expected the number of a body");
  refused([&] { make_ball(bodies, -1, 0, o); }, "a: expected the number of a body");
  refused([&] { make_ball(bodies, 0, 9, o); }, "b: expected the number of a body");
  refused([&] { make_ball(bodies, 0, -2, o); }, "b: expected the number of a body");
  refused([&] { make_fixed(bodies, 1, 1, o); }, "body 1 twice");
  refused([&] { make_fixed(bodies, 2, 3, o); }, "needs a dynamic body");
  refused([&] { make_fixed(bodies, 2, -1, o); }, "needs a dynamic body");
  refused([&] { make_hinge(bodies, 0, 1, o, o); }, "axis");
  refused([&] { make_hinge(bodies, 0, 1, o, {0, nan, 1}); }, "axis");
  refused([&] { make_slider(bodies, 0, 1, {nan, 0, 0}, x); }, "anchor");
  refused([&] { make_universal(bodies, 0, 1, o, x, o); }, "axis_b");
  refused([&] { make_universal(bodies, 0, 1, o, x, x); }, "at right angles");
  refused([&] { make_distance(bodies, 0, 1, o, {nan, 0, 0}); }, "point_b");
  refused([&] { check_joint(make_distance(bodies, 0, 1, o, o), bodies); }, "upper");

  const auto changed = [&](Joint joint, const std::function<void(Joint&)>& change,
                           const std::string& words) {
    check_joint(joint, bodies);
    change(joint);
    refused([&] { check_joint(joint, bodies); }, words);
  };
  const Joint ball = make_ball(bodies, 0, 1, o), hinge = make_hinge(bodies, 0, -1, o, 1e-200 * x);
  const Joint fixed = make_fixed(bodies, 0, 2, o), slider = make_slider(bodies, 3, 0, o, x);
  const Joint rod = make_distance(bodies, 0, 1, o, x);
  changed(hinge, [](Joint& j) { j.lower = 1, j.upper = 0; }, "lower <= upper");
  changed(hinge, [&](Joint& j) { j.lower = nan; }, "lower <= upper");
  changed(slider, [](Joint& j) { j.lower = Joint::kInfinite, j.upper = j.lower; }, "lower, upper");
  changed(rod, [](Joint& j) { j.lower = -2, j.upper = -1; }, "upper: expected a distance");
  changed(fixed, [](Joint& j) { j.upper = 1; }, "fixed and elastic joints have no limits");
  changed(ball, [](Joint& j) { j.upper = 4; }, "twist");
  changed(ball, [](Joint& j) { j.cone = 0; }, "cone");
  changed(ball, [&](Joint& j) { j.cone = nan; }, "cone");
  changed(hinge, [](Joint& j) { j.cone = 1; }, "cone: only balls");
  changed(ball, [](Joint& j) { j.motor.type = MotorType::kSpeed; }, "motor: only");
  changed(
      hinge, [&](Joint& j) { j.motor = {.type = MotorType::kSpeed, .target = nan}; },
      "motor.target");
  changed(hinge, [](Joint& j) { j.motor = {.type = MotorType::kSpeed, .most = -1}; }, "motor.most");
  changed(hinge, [](Joint& j) { j.motor = {.type = MotorType::kSpring}; }, "motor.stiffness");
  changed(
      rod, [](Joint& j) { j.motor = {.type = MotorType::kSpring, .stiffness = -1}; },
      "motor.stiffness");
  changed(
      rod,
      [](Joint& j) {
        j.motor = {.type = MotorType::kSpring, .stiffness = 1, .damping = Joint::kInfinite};
      },
      "motor.damping");
  const Joint elastic = make_elastic(bodies, 0, 1, o, x);
  changed(elastic, [](Joint& j) { j.lower = 0; }, "elastic joints have no limits");
  changed(elastic, [](Joint& j) { j.motor.type = MotorType::kSpeed; }, "motor: only");
  changed(elastic, [](Joint& j) { j.spring.rest.y() = 4; }, "spring.rest");
  changed(elastic, [](Joint& j) { j.spring.swing_damping = -1; }, "spring: expected");
  changed(hinge, [](Joint& j) { j.in_a.axes = Quaternion(0, 0, 0, 0); }, "in_a.axes");
  changed(hinge, [&](Joint& j) { j.in_b.anchor.x() = nan; }, "in_b.anchor");
  changed(hinge, [&](Joint& j) { j.impulse[5] = nan; }, "impulse");
}

}  // namespace
