#include "substep/rigid/solver/joint_rows.h"

#include <numbers>

namespace substep::rigid {
namespace {

using V = JointLanes;

constexpr double kTurn = 2 * std::numbers::pi;

V nearest(const V& angle, const V& near) {
  return angle + kTurn * floor(V((near - angle) / kTurn + 0.5));
}

JointVector unit(int i) {
  JointVector e{};
  e[i] = splat<V>(1);
  return e;
}

// A direction for what has none.
JointVector direction(const JointVector& v, const JointVector& otherwise) {
  const V length = square_root(dot(v, v));
  const auto some = length > 0.0;
  const V scale = 1.0 / select(some, length, splat<V>(1));
  JointVector e;
  for (int i = 0; i < 3; ++i) e[i] = select(some, V(scale * v[i]), otherwise[i]);
  return e;
}

// J: the rates of a rotation vector v are J w, of what turns at w. With a = |v|,
//   J = 1 - [v] / 2 + (1 - a / 2 cot(a / 2)) / a^2 [v]^2
// (Bortz 1971, IEEE Trans. Aerosp. Electron. Syst. 7, eq. 10).
Matrix3<V> vector_rates(const JointVector& v) {
  const V square = dot(v, v), half = 0.5 * square_root(square);
  V sine, cosine;
  Sincos<V>{}(half, sine, cosine);
  const auto large = square > 1e-4;
  const V c = select(
      large,
      (1.0 - half * cosine / select(large, sine, splat<V>(1))) / select(large, square, splat<V>(1)),
      1.0 / 12 + square / 720.0);
  Matrix3<V> J;
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    J(i, i) = 1.0 + c * (v[i] * v[i] - square);
    J(i, j) = c * v[i] * v[j] + 0.5 * v[k];
    J(i, k) = c * v[i] * v[k] - 0.5 * v[j];
  }
  return J;
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

bool is_turn(JointType type, int row) {
  if (type == JointType::kDistance) return false;
  return type == JointType::kSlider ? row > 1 && row < 5 : row > 2;
}

void JointFrames::set(int lane, const Joint::Frame& frame) {
  axes.w[lane] = frame.axes.w();
  for (int i = 0; i < 3; ++i) {
    anchor[i][lane] = frame.anchor[i];
    axes.v[i][lane] = frame.axes.vec()[i];
  }
}

JointSides::JointSides(const Joint::Frame& frame, const Vec3& x, const Quaternion& q) {
  const Vec3 at = q * frame.anchor;
  const Quaternion turn = q * frame.axes;
  axes.w = splat<V>(turn.w());
  for (int i = 0; i < 3; ++i) {
    centre[i] = splat<V>(x[i]), arm[i] = splat<V>(at[i]);
    axes.v[i] = splat<V>(turn.vec()[i]);
  }
}

void joint_values(JointType type, const JointSides& a, const JointSides& b, const V& near,
                  bool coordinates, V* C) {
  const JointVector d = (a.centre - b.centre) + (a.arm - b.arm);
  if (type == JointType::kDistance) {
    C[0] = square_root(dot(d, d));
    return;
  }
  const JointQuaternion turn = b.axes.conjugate() * a.axes;
  const auto rotation = [&](V* to) {
    const V sign = select(turn.w < 0.0, splat<V>(-2), splat<V>(2));
    for (int i = 0; i < 3; ++i) to[i] = sign * turn.v[i];
  };
  if (type == JointType::kSlider) {
    const JointVector local = b.axes.conjugate().rotated(d);
    C[0] = local[1], C[1] = local[2], C[5] = local[0];
    rotation(C + 2);
    return;
  }
  for (int i = 0; i < 3; ++i) C[i] = d[i];
  if (type == JointType::kFixed) {
    rotation(C + 3);
    return;
  }
  if (type == JointType::kElastic) {
    const JointVector vector = rotation_vector(turn);
    for (int i = 0; i < 3; ++i) C[3 + i] = vector[i];
    return;
  }
  const JointVector n = turn.column(0);  // n_a as b sees it
  if (type == JointType::kUniversal) {
    C[3] = n[1];
    if (!coordinates) return;
    C[4] = nearest(atan2<V>(-turn.column(2)[1], turn.column(1)[1]), near);
    C[5] = atan2<V>(-n[2], n[0]);
  } else if (type == JointType::kHinge) {
    C[3] = -n[2], C[4] = n[1];
    const JointVector e = turn.column(1);
    if (coordinates) C[5] = nearest(atan2<V>(e[2], e[1]), near);
  } else if (coordinates) {
    C[3] = atan2<V>(square_root(n[1] * n[1] + n[2] * n[2]), n[0]);
    C[4] = nearest(2.0 * atan2<V>(turn.v[0], turn.w), near);
  }
}

void joint_gradients(JointType type, const JointSides& a, const JointSides& b, JointGradients& G) {
  const JointVector d = (a.centre - b.centre) + (a.arm - b.arm);
  const JointVector n_a = a.axes.column(0), n_b = b.axes.column(0);
  G.arm_a = a.arm, G.arm_b = b.arm;
  switch (type) {
    case JointType::kDistance:
      G.axis[0] = direction(d, n_b);
      return;
    case JointType::kSlider:
      G.arm_b = b.arm + d;
      for (int i = 0; i < 3; ++i) G.axis[i == 0 ? 5 : i - 1] = G.axis[2 + i] = b.axes.column(i);
      return;
    case JointType::kBall:
    case JointType::kHinge:
    case JointType::kUniversal:
    case JointType::kElastic:
    case JointType::kFixed:
      for (int i = 0; i < 3; ++i) G.axis[i] = unit(i);
  }
  if (type == JointType::kFixed) {
    for (int i = 0; i < 3; ++i) G.axis[3 + i] = b.axes.column(i);
  } else if (type == JointType::kHinge) {
    for (int i = 1; i < 3; ++i) G.axis[2 + i] = cross(n_a, cross(b.axes.column(i), n_b));
    G.axis[5] = n_b;
  } else if (type == JointType::kElastic) {
    const Matrix3<V> J = vector_rates(rotation_vector(b.axes.conjugate() * a.axes));
    for (int i = 0; i < 3; ++i) G.axis[3 + i] = b.axes.rotated({{J(i, 0), J(i, 1), J(i, 2)}});
  } else if (type == JointType::kUniversal) {
    const JointVector e = b.axes.column(1);
    G.axis[3] = cross(n_a, e);
    G.axis[4] = n_a;
    G.axis[5] = e;
  } else {
    G.axis[3] = direction(cross(n_b, n_a), b.axes.column(1));
    const V most = 1.0 + dot(n_a, n_b);
    G.axis[4] = (1.0 / select(most > 1e-9, most, splat<V>(1e-9))) * (n_a + n_b);
    G.axis[5] = {};
  }
}

}  // namespace substep::rigid
