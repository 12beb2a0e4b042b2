#include "substep/rigid/solver/joint_rows.h"

#include <cmath>
#include <numbers>

#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;

double nearest(double angle, double near) {
  return angle + kTurn * std::nearbyint((near - angle) / kTurn);
}

// A direction for what has none.
Vec3 direction(const Vec3& v, const Vec3& otherwise) {
  const double length = v.norm();
  return length > 0 ? Vec3(v / length) : otherwise;
}

void set(JointGradients& G, int row, const Vec3& linear, const Vec3& arm_a, const Vec3& arm_b) {
  G.linear[row] = linear;
  G.angular_a[row] = arm_a.cross(linear);
  G.angular_b[row] = arm_b.cross(linear);
}

// J: the rates of a rotation vector v are J w, of what turns at w. With a = |v|,
//   J = 1 - [v] / 2 + (1 - a / 2 cot(a / 2)) / a^2 [v]^2
// (Bortz 1971, IEEE Trans. Aerosp. Electron. Syst. 7, eq. 10).
Mat3 vector_rates(const Vec3& v) {
  const double square = v.squaredNorm(), half = std::sqrt(square) / 2;
  const double c = square < 1e-4 ? 1. / 12 + square / 720 : (1 - half / std::tan(half)) / square;
  Mat3 V;
  V << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return Mat3::Identity() - 0.5 * V + c * (V * V);
}

void set_turn(JointGradients& G, int row, const Vec3& axis) {
  G.linear[row].setZero();
  G.angular_a[row] = G.angular_b[row] = axis;
}

}  // namespace

int joint_equations(JointType type) {
  switch (type) {
    case JointType::kBall:
    case JointType::kElastic:
      return 3;
    case JointType::kUniversal:
      return 4;
    case JointType::kHinge:
    case JointType::kSlider:
      return 5;
    case JointType::kFixed:
      return 6;
    case JointType::kDistance:
      break;
  }
  return 0;
}

int joint_rows(const Joint& joint) {
  if (joint.type == JointType::kElastic) return 6;
  const bool ruled = joint.lower > -Joint::kInfinite || joint.upper < Joint::kInfinite ||
                     joint.motor.type != MotorType::kNone;
  if (ruled) return coordinate_row(joint.type) + 1;
  return joint_equations(joint.type) + (joint.cone < Joint::kInfinite ? 1 : 0);
}

int coordinate_row(JointType type) {
  if (type == JointType::kFixed) return -1;
  return type == JointType::kBall ? 4 : joint_equations(type);
}

std::array<double, kJointRows> joint_values(JointType type, const JointSide& a, const JointSide& b,
                                            double near, bool coordinates) {
  std::array<double, kJointRows> C{};
  const Vec3 d = (a.centre - b.centre) + (a.arm - b.arm);
  if (type == JointType::kDistance) {
    C[0] = d.norm();
    return C;
  }
  Quaternion turn = b.axes.conjugate() * a.axes;
  const auto rotation = [&](std::size_t first) {
    const double sign = turn.w() < 0 ? -2 : 2;
    C[first] = sign * turn.x(), C[first + 1] = sign * turn.y(), C[first + 2] = sign * turn.z();
  };
  if (type == JointType::kSlider) {
    const Vec3 local = b.axes.conjugate() * d;
    C[0] = local.y(), C[1] = local.z(), C[5] = local.x();
    rotation(2);
    return C;
  }
  for (int i = 0; i < 3; ++i) C[usize(i)] = d[i];
  if (type == JointType::kFixed) {
    rotation(3);
    return C;
  }
  if (type == JointType::kElastic) {
    const Vec3 vector = rotation_vector(turn);
    for (int i = 0; i < 3; ++i) C[usize(3 + i)] = vector[i];
    return C;
  }
  const Vec3 n = rotated(turn, Vec3::UnitX());  // n_a as b sees it
  if (type == JointType::kUniversal) {
    C[3] = n.y();
    if (!coordinates) return C;
    C[4] = nearest(std::atan2(-rotated(turn, Vec3::UnitZ()).y(), rotated(turn, Vec3::UnitY()).y()),
                   near);
    C[5] = std::atan2(-n.z(), n.x());
  } else if (type == JointType::kHinge) {
    const Vec3 e = rotated(turn, Vec3::UnitY());
    C[3] = -n.z(), C[4] = n.y();
    if (coordinates) C[5] = nearest(std::atan2(e.z(), e.y()), near);
  } else if (coordinates) {
    C[3] = std::atan2(std::hypot(n.y(), n.z()), n.x());
    C[4] = nearest(2 * std::atan2(turn.x(), turn.w()), near);
  }
  return C;
}

JointGradients joint_gradients(JointType type, const JointSide& a, const JointSide& b) {
  JointGradients G;
  const Vec3 d = (a.centre - b.centre) + (a.arm - b.arm);
  const Mat3 B = b.axes.toRotationMatrix();
  const Vec3 n_a = rotated(a.axes, Vec3::UnitX()), n_b = B.col(0);
  switch (type) {
    case JointType::kDistance:
      set(G, 0, direction(d, n_b), a.arm, b.arm);
      return G;
    case JointType::kSlider:
      for (int i = 0; i < 3; ++i) {
        set(G, i == 0 ? 5 : i - 1, B.col(i), a.arm, b.arm + d);
        set_turn(G, 2 + i, B.col(i));
      }
      return G;
    case JointType::kBall:
    case JointType::kHinge:
    case JointType::kUniversal:
    case JointType::kElastic:
    case JointType::kFixed:
      for (int i = 0; i < 3; ++i) set(G, i, Vec3::Unit(i), a.arm, b.arm);
  }
  if (type == JointType::kFixed) {
    for (int i = 0; i < 3; ++i) set_turn(G, 3 + i, B.col(i));
  } else if (type == JointType::kHinge) {
    for (int i = 1; i < 3; ++i) set_turn(G, 2 + i, n_a.cross(B.col(i).cross(n_b)));
    set_turn(G, 5, n_b);
  } else if (type == JointType::kElastic) {
    const Mat3 J = vector_rates(rotation_vector(b.axes.conjugate() * a.axes));
    for (int i = 0; i < 3; ++i) set_turn(G, 3 + i, B * J.row(i).transpose());
  } else if (type == JointType::kUniversal) {
    set_turn(G, 3, n_a.cross(B.col(1)));
    set_turn(G, 4, n_a);
    set_turn(G, 5, B.col(1));
  } else {
    set_turn(G, 3, direction(n_b.cross(n_a), B.col(1)));
    set_turn(G, 4, (n_a + n_b) / std::max(1 + n_a.dot(n_b), 1e-9));
  }
  return G;
}

}  // namespace substep::rigid
