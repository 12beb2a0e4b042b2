#include "substep/rigid/solver/mobility.h"

#include <Eigen/Cholesky>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>

#include "substep/core/usize.h"
#include "substep/rigid/solver/joint_rows.h"

namespace substep::rigid {
namespace {

using Row6 = Eigen::Matrix<double, 1, 6>;
using Tall = Eigen::Matrix<double, Eigen::Dynamic, 6>;

// |C| = (C C^T)^1/2.
Mat6 length(const Mat6& C) {
  const Eigen::JacobiSVD<Mat6> svd(C, Eigen::ComputeFullU);
  return svd.matrixU() * svd.singularValues().asDiagonal() * svd.matrixU().transpose();
}

Mat6 free_mobility(const Bodies& bodies, std::int64_t b) {
  Mat6 W = Mat6::Zero();
  W.topLeftCorner<3, 3>().diagonal().setConstant(bodies.inverse_mass(b));
  if (bodies.dynamic(b)) W.bottomRightCorner<3, 3>() = bodies.inverse_inertia(b);
  return W;
}

// One equation of a joint: its gradients for the two bodies, and how far it yields to an impulse.
struct Equation {
  std::int32_t a, b;
  Row6 of_a, of_b;
  double softness;
};

constexpr double kInfinite = std::numeric_limits<double>::infinity();

// How far a spring yields to an impulse over dt, in a row that would move by W without it: by
// Newmark's method. One that rings for longer does not answer the same in the next step: it holds
// nothing.
double softness_of_spring(double stiffness, double damping, double W, double dt) {
  constexpr double kRings = 0.1;  // of its amplitude, after dt
  const double x = dt * std::sqrt(stiffness * W), g = dt * damping * W / 2;
  const double decay = g > x ? x * x / (2 * g) : g;  // of the slowest part
  return std::exp(-decay) < kRings ? W / (x * x / 4 + g) : kInfinite;
}

// Of a row of a joint: 0 of equations, infinite of what is free.
double softness(const Joint& joint, int row, bool held, double W, double dt) {
  const int equations = joint_equations(joint.type);
  if (row < equations) return 0;
  if (joint.type == JointType::kElastic) {
    const Joint::Spring& s = joint.spring;
    return row == equations ? softness_of_spring(s.twist_stiffness, s.twist_damping, W, dt)
                            : softness_of_spring(s.swing_stiffness, s.swing_damping, W, dt);
  }
  if (!held || row != coordinate_row(joint.type)) return kInfinite;
  if (joint.motor.type != MotorType::kSpring) return 0;
  return softness_of_spring(joint.motor.stiffness, joint.motor.damping, W, dt);
}

JointSides side(const Bodies& bodies, std::int32_t b, const Joint::Frame& frame) {
  if (b < 0) return {frame, Vec3::Zero(), Quaternion::Identity()};
  return {frame, bodies.position(b), bodies.rotation(b)};
}

Vec3 first_lane(const JointVector& v) { return {v[0][0], v[1][0], v[2][0]}; }

// How an impulse alone moves the row.
double response(const Bodies& bodies, const Equation& e) {
  double W = 0;
  for (const auto& [b, gradient] : {std::pair{e.a, e.of_a}, std::pair{e.b, e.of_b}}) {
    if (b >= 0) W += gradient.dot(gradient * free_mobility(bodies, b));
  }
  return W;
}

void add_equations(const Bodies& bodies, const Joint& joint, bool held, double dt,
                   std::vector<Equation>& equations) {
  JointGradients G;
  joint_gradients(joint.type, side(bodies, joint.a, joint.in_a), side(bodies, joint.b, joint.in_b),
                  G);
  for (int i = 0; i < kJointRows; ++i) {
    const Vec3 axis = first_lane(G.axis[i]);
    Equation e{joint.a, joint.b, Row6::Zero(), Row6::Zero(), 0};
    if (is_turn(joint.type, i)) {
      e.of_a.tail<3>() = axis.transpose();
      e.of_b.tail<3>() = -axis.transpose();
    } else {
      e.of_a.head<3>() = axis.transpose(), e.of_b.head<3>() = -axis.transpose();
      e.of_a.tail<3>() = first_lane(G.arm_a).cross(axis).transpose();
      e.of_b.tail<3>() = -first_lane(G.arm_b).cross(axis).transpose();
    }
    e.softness = softness(joint, i, held, response(bodies, e), dt);
    if (e.softness < kInfinite) equations.push_back(e);
  }
}

// Which bodies joints hold together: the least number among them.
std::vector<std::int32_t> groups_of(const Bodies& bodies, std::span<const Joint> joints) {
  std::vector<std::int32_t> group(usize(bodies.size()));
  std::iota(group.begin(), group.end(), 0);
  const auto find = [&](std::int32_t b) {
    while (group[usize(b)] != b) b = group[usize(b)] = group[usize(group[usize(b)])];
    return b;
  };
  for (const Joint& joint : joints) {
    if (joint.b < 0 || !bodies.dynamic(joint.a) || !bodies.dynamic(joint.b)) continue;
    const auto [low, high] = std::minmax({find(joint.a), find(joint.b)});
    group[usize(high)] = low;
  }
  for (std::int32_t b = 0; b < static_cast<std::int32_t>(group.size()); ++b) find(b);
  for (std::int32_t& g : group) g = find(g);
  return group;
}

}  // namespace

std::vector<double> parts_of_strength(std::span<const Joint> joints) {
  std::vector<double> parts;
  for (const Joint& joint : joints) {
    const bool rod = joint.type == JointType::kDistance && joint.lower == joint.upper;
    const double effort = std::abs(joint.effort);
    parts.push_back(rod ? 0
                    : joint.motor.type != MotorType::kNone && effort < joint.motor.most
                        ? effort / joint.motor.most
                        : 1);
  }
  return parts;
}

std::vector<Mat6> mobilities(const Bodies& bodies, std::span<const Joint> joints,
                             std::span<const std::uint8_t> held, std::span<const std::int64_t> rows,
                             double dt) {
  constexpr std::size_t kMost = 150;    // equations
  constexpr double kRedundant = 1e-12;  // of the diagonal, where loops say things twice
  std::vector<Mat6> found;
  for (const std::int64_t row : rows) found.push_back(free_mobility(bodies, row));
  if (joints.empty()) return found;
  const std::vector<std::int32_t> group = groups_of(bodies, joints);
  std::map<std::int32_t, std::vector<std::size_t>> asked;  // places in `rows`, by group
  for (std::size_t k = 0; k < rows.size(); ++k) {
    if (bodies.dynamic(rows[k])) asked[group[usize(rows[k])]].push_back(k);
  }
  std::map<std::int32_t, std::vector<Equation>> equations;
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const std::int32_t b = bodies.dynamic(joints[j].a) ? joints[j].a : joints[j].b;
    if (b < 0 || !asked.contains(group[usize(b)])) continue;
    add_equations(bodies, joints[j], held[j] != 0, dt, equations[group[usize(b)]]);
  }
  for (const auto& [number, together] : equations) {
    const auto n = static_cast<Eigen::Index>(together.size());
    if (together.empty() || together.size() > kMost) continue;
    // G M^-1, by the bodies that it concerns.
    std::map<std::int32_t, Tall> G;
    for (Eigen::Index i = 0; i < n; ++i) {
      const Equation& e = together[usize(i)];
      for (const auto& [b, gradient] : {std::pair{e.a, e.of_a}, std::pair{e.b, e.of_b}}) {
        if (b < 0 || !bodies.dynamic(b)) continue;
        if (!G.contains(b)) G[b].setZero(n, 6);
        G[b].row(i) += gradient;
      }
    }
    Eigen::MatrixXd D = Eigen::MatrixXd::Zero(n, n);
    for (const auto& [b, g] : G) D += g * free_mobility(bodies, b) * g.transpose();
    D.diagonal() *= 1 + kRedundant;
    for (Eigen::Index i = 0; i < n; ++i) D(i, i) += together[usize(i)].softness;
    const Eigen::LDLT<Eigen::MatrixXd> factor(D);
    const std::vector<std::size_t>& bodies_asked = asked[number];
    std::vector<Mat6> R;
    std::vector<Tall> H, X;
    for (const std::size_t k : bodies_asked) {
      R.push_back(found[k].llt().matrixL());
      const auto own = G.find(static_cast<std::int32_t>(rows[k]));
      H.push_back(own == G.end() ? Tall(Tall::Zero(n, 6)) : Tall(own->second * R.back()));
      X.push_back(factor.solve(H.back()));
    }
    for (std::size_t a = 0; a < bodies_asked.size(); ++a) {
      Mat6 S = Mat6::Identity() - H[a].transpose() * X[a];
      for (std::size_t b = 0; b < bodies_asked.size(); ++b) {
        if (b != a) S += length(H[a].transpose() * X[b]);
      }
      const Mat6 W = R[a] * S * R[a].transpose();
      found[bodies_asked[a]] = 0.5 * (W + W.transpose());
    }
  }
  return found;
}

}  // namespace substep::rigid
