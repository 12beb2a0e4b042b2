#include "substep/rigid/solver/tree_group.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "substep/rigid/solver/joint_rows.h"

namespace substep::rigid {
namespace {

using Kind = ArticulatedTree::Kind;

bool same(const Quad3& a, const Quad3& b) { return a[0] == b[0] && a[1] == b[1] && a[2] == b[2]; }

// Of what is small to 1e-10.
double arctangent(double t) {
  const double s = t * t;
  return s < 0.01 ? t * (1 - s * (1. / 3 - s * (1. / 5 - s / 7))) : std::atan(t);
}

bool serves(const Joint& joint) {
  const bool kind = joint.type == JointType::kBall || joint.type == JointType::kFixed;
  return joint.type == JointType::kHinge || joint.type == JointType::kSlider ||
         (kind && joint_rows(joint) == joint_equations(joint.type));
}

}  // namespace

std::optional<TreeGroup> TreeGroup::make(std::span<const std::int32_t> numbers,
                                         std::span<const Joint> joints, const BodyRows& rows) {
  struct Edge {
    std::int32_t joint, a, b;  // bodies, -1: the world
  };
  std::vector<Edge> edges;
  std::vector<std::int32_t> bodies;
  for (const std::int32_t number : numbers) {
    const Joint& joint = joints[usize(number)];
    if (!serves(joint)) return {};
    Edge edge{number, joint.a, joint.b};
    for (std::int32_t* body : {&edge.a, &edge.b}) {
      const std::int32_t row = rows.row(*body);
      if (row != 0 && !rows.moves(row)) return {};  // is moved by hand
      if (row == 0) *body = -1;
      if (*body >= 0) bodies.push_back(*body);
    }
    edges.push_back(edge);
  }
  const auto joints_of = [&](std::int32_t body) {
    return std::count(bodies.begin(), bodies.end(), body);
  };
  // From the world, or the body of most joints.
  std::int32_t root = -1;
  const auto grounded =
      std::count_if(edges.begin(), edges.end(), [](const Edge& e) { return e.a < 0 || e.b < 0; });
  if (grounded == 0)
    root = *std::max_element(bodies.begin(), bodies.end(), [&](std::int32_t p, std::int32_t q) {
      return std::pair(joints_of(p), -p) < std::pair(joints_of(q), -q);
    });
  if (grounded > 1) return {};

  std::vector<Tree::Part> parts;
  std::vector<Member> members;
  const auto add = [&](Kind kind, std::int32_t parent, std::int32_t body, const Edge& edge) {
    Tree::Part part;
    part.kind = kind;
    part.parent = parent;
    parts.push_back(part);
    Member member{};
    member.body = body;
    member.joint = edge.joint;
    member.is_a = edge.joint < 0 || joints[usize(edge.joint)].a == body;
    members.push_back(member);
  };
  if (grounded == 0) add(Kind::kFree, -1, root, {-1, -1, -1});
  std::vector<std::uint8_t> used(edges.size(), 0);
  for (std::int64_t parent = grounded == 0 ? 0 : -1;
       parent < static_cast<std::int64_t>(members.size()); ++parent) {
    const std::int32_t body = parent < 0 ? -1 : members[usize(parent)].body;
    for (std::size_t e = 0; e < edges.size(); ++e) {
      const Edge& edge = edges[e];
      if (used[e] != 0 || (edge.a != body && edge.b != body)) continue;
      used[e] = 1;
      const std::int32_t child = edge.a == body ? edge.b : edge.a;
      const auto known = [&](const Member& m) { return m.body == child; };
      if (child < 0 || std::any_of(members.begin(), members.end(), known)) return {};  // a loop
      const JointType type = joints[usize(edge.joint)].type;
      add(type == JointType::kHinge    ? Kind::kHinge
          : type == JointType::kSlider ? Kind::kSlider
          : type == JointType::kBall   ? Kind::kBall
                                       : Kind::kFixed,
          static_cast<std::int32_t>(parent), child, edge);
    }
  }
  return TreeGroup(std::move(parts), std::move(members));
}

TreeGroup::TreeGroup(std::vector<Tree::Part> parts, std::vector<Member> members)
    : tree_(std::move(parts)), rows_(members.size()), members_(std::move(members)) {
  const std::size_t n = members_.size();
  begin_.resize(n), end_.resize(n), now_.resize(n), next_.resize(n);
  momenta_.resize(n), found_.resize(n), wanted_.resize(n), given_.resize(n);
  aside_.resize(n), arms_.resize(n), turns_.resize(n);
  rates_.resize(n), last_rates_.resize(n), older_rates_.resize(n), change_.resize(n),
      last_change_.resize(n);
}

// Frames of the joint of part k, in its parent's coordinates.
void TreeGroup::set_joint(std::size_t k, const Joint& joint, const Bodies& bodies) {
  Tree::Part& part = tree_.parts()[k];
  Member& m = members_[k];
  const Joint::Frame& own = m.is_a ? joint.in_a : joint.in_b;
  Joint::Frame other = m.is_a ? joint.in_b : joint.in_a;
  if (part.parent >= 0) {
    other.anchor += vec(tree_.parts()[usize(part.parent)].centre);
  } else if (const std::int32_t ground = m.is_a ? joint.b : joint.a; ground >= 0) {
    other.anchor = bodies.pose(ground).to_world(other.anchor);
    other.axes = bodies.rotation(ground) * other.axes;
  }
  part.anchor = quad(other.anchor);
  part.centre = quad(Vec3(-own.anchor));
  const Mat3 F = other.axes.toRotationMatrix(), inner = own.axes.toRotationMatrix().transpose();
  if (part.kind == Kind::kFixed || part.kind == Kind::kSlider) {
    part.turning[0] = QuadMatrix::of(F * inner);
  } else {
    Mat3 quarter;
    quarter << 0, 0, 0, 0, 0, -1, 0, 1, 0;
    const Vec3 along = Vec3::UnitX(), across(0, 1, 1);
    part.turning = {QuadMatrix::of(F * along.asDiagonal() * inner),
                    QuadMatrix::of(F * across.asDiagonal() * inner),
                    QuadMatrix::of(F * quarter * inner)};
  }
  part.axis = quad(Vec3(F.col(0)));
  m.coordinate = joint.coordinate;
  m.ruled = joint_rows(joint) > joint_equations(joint.type);
  if (!m.ruled) return;
  ruled_ = true;
  m.lower = joint.lower, m.upper = joint.upper;
  m.motor = joint.motor;
  m.mode = JointLaw::Mode::kFree;
  m.last = joint.impulse[5];
  m.sum_along = 0;
}

// Those of the bodies. Returns whether the joints are closed there.
bool TreeGroup::set_coordinates(const Bodies& bodies) {
  const auto& parts = tree_.parts();
  const auto rotation_of = [&](std::int32_t part) {
    return part < 0
               ? QuadMatrix::identity()
               : QuadMatrix::of(bodies.rotation(members_[usize(part)].body).toRotationMatrix());
  };
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Tree::Coordinate& at = begin_[k];
    at.q = bodies.rotation(members_[k].body);
    at.x = quad(bodies.position(members_[k].body));
    const std::int32_t parent = parts[k].parent;
    if (parts[k].kind == Kind::kSlider) {
      const QuadMatrix R_parent = rotation_of(parent);
      Quad3 to = at.x - rotation_of(static_cast<std::int32_t>(k)) * parts[k].centre;
      if (parent >= 0) to -= begin_[usize(parent)].x - R_parent * parts[usize(parent)].centre;
      at.way = dot(R_parent * parts[k].axis, to - R_parent * parts[k].anchor);
    }
    if (parts[k].kind != Kind::kHinge) continue;
    const QuadMatrix R = rotation_of(static_cast<std::int32_t>(k));
    const QuadMatrix relative = transpose(rotation_of(parent)) * R;
    const auto along = [&](const QuadMatrix& A) {
      return dot(A[0], relative[0]) + dot(A[1], relative[1]) + dot(A[2], relative[2]);
    };
    const double c = along(parts[k].turning[1]), s = along(parts[k].turning[2]);
    const double length = std::hypot(c, s);
    at.cosine = c / length, at.sine = s / length;
  }
  tree_.place(begin_, now_);
  const auto is_closed = [](const Quad3& error) { return dot(error, error) < kClosed * kClosed; };
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const QuadMatrix R = rotation_of(static_cast<std::int32_t>(k));
    const Quad3 x = quad(bodies.position(members_[k].body));
    if (!is_closed(now_[k].x - x)) return false;
    for (int i = 0; i < 3; ++i)
      if (!is_closed(now_[k].R[i] - R[i])) return false;
  }
  return true;
}

bool TreeGroup::begin_step(std::span<const Joint> joints, std::span<const std::uint8_t> pressed,
                           const Bodies& bodies, const JointGroup::Settings& settings,
                           BodyRows& rows) {
  h_ = substep_ = settings.h;
  push_ = settings.push;
  smooth_ = std::none_of(members_.begin(), members_.end(), [&](const Member& m) {
    return pressed[usize(m.body)] == JointGroup::kPressed;
  });
  alone_ = std::none_of(members_.begin(), members_.end(),
                        [&](const Member& m) { return pressed[usize(m.body)] != 0; });
  ruled_ = false;
  mass_ = 0;
  weight_ = smooth_ ? 0.5 : 1;
  if (settings.method != FreeRotation::kSplitting || !(h_ > kShortest)) return false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    Tree::Part& part = tree_.parts()[k];
    const double* const I = &bodies.inertia[3 * usize(m.body)];
    part.inertia = part.seen_inertia = Quad3{I[0], I[1], I[2], bodies.mass[usize(m.body)]};
    m.inverse_inertia = 1 / part.inertia;
    mass_ += part.inertia[3];
    part.slow = false;
    m.impulse = {};
    if (m.joint >= 0) {
      set_joint(k, joints[usize(m.joint)], bodies);
      m.impulse.linear = (m.is_a ? 1 : -1) * quad(Vec3(joints[usize(m.joint)].impulse.data()));
    }
    // As it is, and as the torque on it would make it in the step.
    const Quaternion to_body = bodies.rotation(m.body).conjugate();
    Vec3 torque = (to_body * Vec3(&bodies.torque[3 * usize(m.body)])).cwiseAbs();
    if (m.ruled && !slides(k) && m.motor.type == MotorType::kSpeed &&
        !(h_ * std::abs(m.motor.target) < kMostTurn))
      torque.array() += m.motor.most;
    const Vec3 L = (to_body * Vec3(&bodies.L[3 * usize(m.body)])).cwiseAbs() + settings.dt * torque;
    const Vec3 J = vec(part.inertia);
    if (!(h_ * L.cwiseQuotient(J).norm() < kMostTurn)) return false;
    // The inertia of solve() lacks what is of second order in h / 2 [L]: an error grows by less
    // than this in an iteration.
    if (!(0.5 * h_ * L.cwiseProduct(J.cwiseSqrt()).norm() < kMostGrowth * std::sqrt(J.prod())))
      return false;
    const std::int32_t row = rows.row(m.body);
    rates_[k].angular = quad(rows.spin_of(row));
    rates_[k].linear = quad(rows.velocity_of(row));
  }
  if (!set_coordinates(bodies)) return false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    tree_.drive(k) = {};
    if (std::abs(passed(k)) > push_) return false;  // was put apart
  }
  intervals_ = 0;
  find_inertia(rows);
  if (whirls_ && !smooth_) return false;
  tree_.begin(now_);
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    const Tree::Part& part = tree_.parts()[k];
    const Tree::Rate rest;
    const Tree::Rate& parent = part.parent < 0 ? rest : rates_[usize(part.parent)];
    Quad3 moves = rates_[k].angular - parent.angular;
    if (slides(k)) {
      moves = rates_[k].linear - cross(rates_[k].angular, now_[k].c) - parent.linear;
      if (part.parent >= 0) moves -= cross(parent.angular, now_[k].O - now_[usize(part.parent)].x);
    }
    m.rate = rates_[k].along = dot(now_[k].axis, moves);
    last_rates_[k] = older_rates_[k] = rates_[k];
    const Vec3 root = vec(part.inertia).cwiseSqrt();
    const QuadMatrix& R = now_[k].R;
    rows_.set(k, rows.row(m.body), rows, quad(bodies.position(m.body)),
              QuadMatrix{R[0] * root[0], R[1] * root[1], R[2] * root[2]} * transpose(R));
    m.sum = given_[k] = {};
    momenta_[k].angular = quad(Vec3(&bodies.L[3 * usize(m.body)]));
  }
  rows_.begin_step(tree_, momenta_, rows);
  for (const Member& m : members_) rows.led[usize(rows.row(m.body))] = alone_;
  if (smooth_) kick(-0.5 * h_, rows);
  return true;
}

// As JointGroup::find_inertia. Most forces are far from swinging anything, which their sums tell.
void TreeGroup::find_inertia(BodyRows& rows) {
  const double most = smooth_ ? JointGroup::kFreeSwing : JointGroup::kSwing;
  const double scale = h_ * h_ / (most * most);
  whirls_ = false;
  if (!may_swing(scale)) {
    for (std::size_t k = 0; k < members_.size(); ++k)
      see_inertia(k, tree_.parts()[k].inertia, rows);
    return;
  }
  for (Arm& arm : arms_) arm = {};
  for_each_arm([&](std::size_t k, const Quad3& arm, const Quad3& r, const Quad3& force) {
    const double K = dot(arm, force) / h_;
    if (!(K > 0)) return;
    arms_[k].stiffness += K * (quad(1, 1, 1) - r * r / dot(r, r));
    arms_[k].arm += K * r;
    arms_[k].sum += K;
  });
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Tree::Part& part = tree_.parts()[k];
    const Arm& arm = arms_[k];
    Quad3 inertia = part.inertia;
    if (arm.sum > 0) {
      const Quad3 r = arm.arm / arm.sum;
      const Quad3 least = scale * arm.stiffness - part.inertia[3] * (dot(r, r) - r * r);
      for (int i = 0; i < 3; ++i) inertia[i] = std::max(inertia[i], least[i]);
      whirls_ = whirls_ || !same(inertia, part.inertia);
    }
    see_inertia(k, inertia, rows);
  }
}

// Force at an arm of the world, which is r in the body, of both bodies of each joint.
template <class Call>
void TreeGroup::for_each_arm(const Call& call) const {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Tree::Part& part = tree_.parts()[k];
    const Quad3& force = members_[k].impulse.linear;
    call(k, -now_[k].c, -part.centre, force);
    if (part.parent < 0) continue;
    const std::size_t parent = usize(part.parent);
    call(parent, now_[k].d - now_[parent].c, part.anchor - tree_.parts()[parent].centre, -force);
  }
}

// No moment that a body needs is above the sum of its stiffnesses, times the scale.
bool TreeGroup::may_swing(double scale) {
  for (Arm& arm : arms_) arm.sum = 0;
  for_each_arm([&](std::size_t k, const Quad3& arm, const Quad3&, const Quad3& force) {
    arms_[k].sum += std::max(dot(arm, force), 0.);
  });
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Quad3& inertia = tree_.parts()[k].inertia;
    const double least = std::min({inertia[0], inertia[1], inertia[2]});
    if (!(scale / h_ * arms_[k].sum < kSurely * least)) return true;
  }
  return false;
}

// Takes energy within a step, as JointGroup::see_inertia.
void TreeGroup::see_inertia(std::size_t k, const Quad3& inertia, BodyRows& rows) {
  Tree::Part& part = tree_.parts()[k];
  if (same(inertia, part.seen_inertia)) return;
  const Quad3 ratio = part.seen_inertia / inertia;
  part.seen_inertia = inertia;
  part.slow = !same(inertia, part.inertia);
  if (intervals_ == 0) return;
  Quad3 kept = ratio;
  for (int i = 0; i < 3; ++i) kept[i] = std::min({1., ratio[i], smooth_ ? 1. : 1 / ratio[i]});
  const QuadMatrix& R = now_[k].R;
  momenta_[k].angular = R * (kept * transposed_product(R, momenta_[k].angular));
  if (!alone_) rows_.give_spin(tree_, k, momenta_, rows);
}

// Of an impulse that changes the angular momentum so.
Quad3 TreeGroup::moment(std::size_t k, const Quad3& change) const {
  const Tree::Part& part = tree_.parts()[k];
  if (!part.slow) return change;
  const QuadMatrix& R = now_[k].R;
  return R * (part.seen_inertia / part.inertia * transposed_product(R, change));
}

// Forces alone, for a time that may be negative.
void TreeGroup::kick(double time, BodyRows& rows) {
  rows_.kick(time, rows, momenta_);
  if (!alone_) rows_.show(tree_, momenta_, rows);
}

// Joints change the momenta to momentum(part).
template <class Call>
void TreeGroup::give(const Call& momentum, BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Tree::Momentum next = momentum(k);
    given_[k].linear += next.linear - momenta_[k].linear;
    given_[k].angular += moment(k, next.angular - momenta_[k].angular);
    momenta_[k] = next;
    members_[k].given_along = members_[k].along;
  }
  if (!alone_) rows_.give(tree_, momenta_, rows);
}

// The rates of a smooth motion go on as those before: of the step's begin, half a sub-step before
// the first, and of the sub-steps since, by the parabola through three.
void TreeGroup::guess_rates() {
  constexpr double kWeights[][3] = {{1, 0, 0}, {3, -2, 0}, {10. / 3, -5, 8. / 3}, {3, -3, 1}};
  const auto& weights = kWeights[smooth_ ? std::min<std::int64_t>(intervals_, 3) : 0];
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Tree::Rate now = rates_[k], &last = last_rates_[k], &older = older_rates_[k];
    const auto guess = [&](auto Tree::Rate::* part) {
      rates_[k].*part = weights[0] * now.*part + weights[1] * last.*part + weights[2] * older.*part;
    };
    guess(&Tree::Rate::linear), guess(&Tree::Rate::angular), guess(&Tree::Rate::along);
    older_rates_[k] = last;
    last_rates_[k] = now;
  }
}

void TreeGroup::begin_substep(BodyRows& rows) {
  if (alone_) {
    kick(h_, rows);
  } else {
    rows_.withdraw(rows);
    rows_.read(rows, momenta_);
  }
  if (intervals_ > 0) find_inertia(rows);
  if (!alone_ && rows_.find_displacements(rows, 0, aside_)) {  // by impacts
    tree_.factor(now_);
    follow(begin_);
    tree_.place(begin_, now_);
    tree_.begin(now_);
  }
  take_back_limits();
  guess_rates();
  set_laws(Stage::kMotion);
  begin_motion();
}

// By displacements without velocity, as near as momenta allow; what is at a limit stays there.
void TreeGroup::take_back_limits() {
  if (!ruled_) return;
  bool any = false;
  for (std::size_t k = 0; k < members_.size(); ++k) any = any || std::abs(passed(k)) > kPassed;
  if (!any) return;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    wanted_[k] = {};
    if (!m.ruled) continue;
    const double y = coordinate(k);
    tree_.drive(k) = {.held = y >= m.upper || y <= m.lower,
                      .change = -sign(k) * std::clamp(passed(k), -push_, push_)};
  }
  tree_.factor(now_);
  tree_.respond(wanted_, change_);
  tree_.advance(change_, 1, begin_);
  tree_.place(begin_, now_);
  tree_.begin(now_);
}

// The angle of a hinge, over turns, or the way of a slider.
double TreeGroup::coordinate(std::size_t k) const {
  if (slides(k)) return sign(k) * begin_[k].way;
  const Member& m = members_[k];
  const double angle = sign(k) * std::atan2(begin_[k].sine, begin_[k].cosine);
  constexpr double kTurn = 2 * std::numbers::pi;
  return angle + kTurn * std::round((m.coordinate - angle) / kTurn);
}

// Of the coordinate in the sub-step.
double TreeGroup::mean_rate(std::size_t k) const {
  const Tree::Coordinate &from = begin_[k], &to = end_[k];
  if (slides(k)) return (to.way - from.way) / h_;
  return std::atan2(to.sine * from.cosine - to.cosine * from.sine,
                    to.cosine * from.cosine + to.sine * from.sine) /
         h_;
}

// How far a limit is passed, below 0 the lower one.
double TreeGroup::passed(std::size_t k) const {
  const Member& m = members_[k];
  if (!m.ruled) return 0;
  const double y = coordinate(k);
  return y - std::clamp(y, m.lower, m.upper);
}

void TreeGroup::set_laws(Stage stage) {
  const JointLaw::Interval interval{h_, weight_, smooth_, false};
  // To the impulse of part k.
  const auto mobility_of = [&](std::size_t member, std::size_t k) {
    const Tree::Place& at = now_[member];
    const Quad3& axis = now_[k].axis;
    const Quad3 n = transposed_product(at.R, slides(k) ? cross(now_[k].O - at.x, axis) : axis);
    const double inverse = members_[member].inverse_inertia[3];
    return dot(n * n, members_[member].inverse_inertia) + (slides(k) ? inverse : 0);
  };
  for (std::size_t k = 0; ruled_ && k < members_.size(); ++k) {
    Member& m = members_[k];
    if (!m.ruled) continue;
    m.along = stage == Stage::kMotion ? weight_ * m.last : 0;  // a guess
    m.given_along = 0;
    const std::int32_t parent = tree_.parts()[k].parent;
    m.mobility = mobility_of(k, k);
    if (parent >= 0) m.mobility += mobility_of(usize(parent), k);
    m.law = JointLaw::make(m.motor, m.lower, m.upper, interval, stage, m.mode, coordinate(k),
                           sign(k) * m.rate, 1 / m.mobility);
  }
}

// Rate along the coordinate of a part that change_ changes: of the motion so far, or none.
double TreeGroup::base_rate(Stage stage, std::size_t k) const {
  return stage == Stage::kMotion ? mean_rate(k) : 0;
}

void TreeGroup::set_drives(Stage stage) {
  for (std::size_t k = 0; ruled_ && k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (!m.ruled) continue;
    const double residual = m.law.residual(m.mode, sign(k) * base_rate(stage, k), 0);
    Tree::Drive& drive = tree_.drive(k) = {};
    if (JointLaw::fixes_impulse(m.mode)) {
      drive.impulse = sign(k) * (m.law.fixed_impulse(m.mode) - m.given_along);
    } else if (m.law.softness(m.mode) > 0) {
      drive.impulse = -sign(k) * (residual / m.law.compliance + m.given_along);
      drive.stiffness = 1 / m.law.compliance;
    } else {
      drive.held = true;
      drive.change = -sign(k) * residual;
    }
  }
}

// By the rates after change_. one: only the first that is another. Returns how many are others.
int TreeGroup::choose_modes(Stage stage, bool one) {
  int others = 0;
  for (std::size_t k = 0; ruled_ && k < members_.size(); ++k) {
    Member& m = members_[k];
    if (!m.ruled) continue;
    const double u = sign(k) * (base_rate(stage, k) + change_[k].along);
    const JointLaw::Mode mode = m.law.next(m.mode, u, m.along, m.mobility, kLittle / h_, one);
    if (mode == m.mode) continue;
    if (!one || others == 0) m.mode = mode;
    ++others;
  }
  return others;
}

// change_ that the wanted momenta ask for, with the modes that it leads to. Returns whether they
// are found.
bool TreeGroup::respond(Stage stage) {
  for (JointPivots pivots; pivots.count < kPivots;) {
    set_drives(stage);
    if (!std::exchange(factored_, true)) {
      ++factors_;
      if (stage == Stage::kMotion) {
        tree_.factor(now_, next_, h_, found_);
      } else {
        tree_.factor(now_);
      }
    }
    tree_.respond(wanted_, change_);
    read_impulses();
    const int others = choose_modes(stage, pivots.one());
    if (others == 0) return true;
    factored_ = false;
    pivots.add(others);
  }
  return false;
}

void TreeGroup::read_impulses() {
  for (std::size_t k = 0; ruled_ && k < members_.size(); ++k)
    if (Member& m = members_[k]; m.ruled) m.along = m.given_along + sign(k) * tree_.impulse(k);
}

// As JointGroup::slow_springs.
bool TreeGroup::slow_springs(Stage stage, std::span<const Tree::Rate> rates) {
  bool any = false;
  for (std::size_t k = 0; ruled_ && k < members_.size(); ++k) {
    Member& m = members_[k];
    const double u = sign(k) * (stage == Stage::kMotion ? mean_rate(k) : rates[k].along);
    const double most = std::max(kMostSprung / h_, std::abs(m.law.before));
    if (!m.ruled || slides(k) || !(m.law.compliance > 0) || !(std::abs(u) > most)) continue;
    m.law.rate = std::copysign(most, u);
    m.law.compliance = 0;
    any = true;
  }
  return any;
}

// From the begin with the rates.
void TreeGroup::begin_motion() {
  factored_ = false;
  drift_ = 0;
  end_ = begin_;
  tree_.advance(rates_, h_, end_);
  double square = 0;
  for (const Tree::Rate& rate : rates_) square = std::max(square, dot(rate.angular, rate.angular));
  turn_ = h_ * std::sqrt(square);
}

// Newton's method with the matrix of the first guess, its steps as long as Aitken's extrapolation
// says (Irons and Tuck 1969, Int. J. Numer. Methods Eng. 1). known: found_ are the momenta of the
// motion but for error_. Returns whether it has found the motion.
bool TreeGroup::solve(double tolerance, bool known) {
  double part = 1, worst = 0;
  for (int i = 0; i < (alone_ ? kIterationsAlone : kIterations); ++i, known = false) {
    if (!known) {
      tree_.place(end_, next_);
      tree_.find_momenta(next_, h_, found_);
      error_ = 0;
    }
    for (std::size_t k = 0; k < members_.size(); ++k) {
      wanted_[k].linear = momenta_[k].linear - found_[k].linear;
      wanted_[k].angular = moment(k, momenta_[k].angular - found_[k].angular);
    }
    last_change_.swap(change_);
    const auto factors = factors_;
    if (!respond(Stage::kMotion)) return false;
    const bool anew = factors_ != factors;
    if (anew) drift_ = 0;
    const double last = std::exchange(worst, 0);
    double along = 0, square = 0;
    for (std::size_t k = 0; k < members_.size(); ++k) {
      const Tree::Rate& change = change_[k];
      const Quad3 less = last_change_[k].angular - change.angular;
      along += dot(less, last_change_[k].angular);
      square += dot(less, less);
      worst =
          std::max({worst, dot(change.linear, change.linear), dot(change.angular, change.angular)});
    }
    worst = h_ * std::sqrt(worst);
    const bool first = anew || i == 0;
    if (first) part = 1;
    if (!first && square > 0) part = std::clamp(part * along / square, kLeastPart, kMostPart);
    drift_ += worst;
    // An iteration leaves what it left before, or what the matrix does not know.
    const double left = first ? turn_ * turn_ / 6 + 2 * drift_ : worst / last;
    if (worst > 0) error_ += std::min(1., left) * worst;
    const bool found = error_ < tolerance;
    const double length = found ? 1 : part;
    for (std::size_t k = 0; k < members_.size(); ++k) {
      rates_[k].linear += length * change_[k].linear;
      rates_[k].angular += length * change_[k].angular;
      rates_[k].along += length * change_[k].along;
    }
    tree_.advance(change_, length * h_, end_);
    if (found) return is_near();
  }
  return !alone_ && worst < kClose && is_near();
}

// Whether the motion found is one near the motion before, not another root, as there may be where a
// chain snaps taut: joints give no energy but by their motors, and turn no body far that turned
// slowly.
bool TreeGroup::is_near() const {
  double given = 0.5 * mass_ * (kPressed / h_) * (kPressed / h_);  // or of what is left of an error
  for (std::size_t k = 0; ruled_ && k < members_.size(); ++k)
    if (const Member& m = members_[k]; m.ruled && m.law.driven)
      given += std::max(0., m.along * sign(k) * rates_[k].along);
  if (tree_.energy(found_) > kMostEnergy * (tree_.energy(momenta_) + given)) return false;
  const double most = alone_ ? kMostWhirl : kMostTurn;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const double square = dot(rates_[k].angular, rates_[k].angular);
    const double before = dot(last_rates_[k].angular, last_rates_[k].angular);
    if (!(h_ * h_ * square <= most * most || square <= 4 * before)) return false;
  }
  return true;
}

// The sub-step of a tree alone in parts, of which all are found. A kick lies between two parts and
// belongs to half of each; that of the whole sub-step was given.
bool TreeGroup::solve_in_parts(double tolerance, BodyRows& rows) {
  if (ruled_) return false;
  const double whole = h_;
  const auto begin = begin_;
  const auto now = now_;
  const auto momenta = momenta_;
  const auto rates = last_rates_;
  const auto members = members_;
  for (int parts = 2; parts <= kMostParts; parts *= 2) {
    h_ = whole / parts;
    kick(-0.5 * (whole - h_), rows);
    bool found = true;
    for (int p = 0; p < parts && found; ++p) {
      if (p > 0) {
        move_in_tree(1. / parts);
        kick(h_, rows);
        last_rates_ = rates_;
      } else {
        rates_ = last_rates_;
      }
      begin_motion();
      found = solve(tolerance);
      if (found) give_found(rows);
    }
    if (found) {
      kick(-0.5 * (whole - h_), rows);
      last_rates_ = older_rates_ = rates_;
      return true;
    }
    begin_ = begin, now_ = now, momenta_ = momenta, last_rates_ = rates, members_ = members;
    for (Tree::Momentum& given : given_) given = {};
    tree_.begin(now_);
  }
  h_ = whole;
  return false;
}

// The momenta as rates, with what laws ask of velocities; at the last, that coordinates stay, which
// takes energy alone.
void TreeGroup::project() {
  for (std::size_t k = 0; k < members_.size(); ++k)
    wanted_[k] = {momenta_[k].linear, moment(k, momenta_[k].angular)};
  factored_ = false;
  if (respond(Stage::kVelocity)) return;
  for (Member& m : members_) {
    m.law.slowest = m.law.fastest = 0;
    m.mode = JointLaw::Mode::kLower;
  }
  respond(Stage::kVelocity);
}

// As the velocities lead.
void TreeGroup::take_velocities(BodyRows& rows) {
  project();
  rates_ = change_;
  end_ = begin_;
  tree_.advance(rates_, h_, end_);
  tree_.place(end_, next_);
  give(
      [&](std::size_t k) {  // L turns with the body: its energy stays
        const Tree::Momentum linear = tree_.momentum(k, change_[k]);
        const Quad3 L = next_[k].R * transposed_product(now_[k].R, linear.angular);
        return Tree::Momentum{linear.linear, L};
      },
      rows);
}

void TreeGroup::solve_motion(double tolerance, bool known, BodyRows& rows) {
  bool found = solve(tolerance, known);
  if (!found && alone_ && solve_in_parts(tolerance, rows)) return;
  if (!found && ruled_) project();
  if (found ? slow_springs(Stage::kMotion, rates_) : slow_springs(Stage::kVelocity, change_)) {
    begin_motion();
    found = solve(tolerance);
  }
  moves_as_found_ = found;
  if (found) {
    give_found(rows);
  } else {
    take_velocities(rows);
  }
}

// What contacts will still change need not be found to the end. What Newton's method leaves is
// linear, and the momenta have it.
void TreeGroup::solve_velocities(BodyRows& rows, bool first, bool last) {
  if (!first && alone_ && solved_) return;
  if (first) {
    begin_substep(rows);
  } else {
    if (moves_as_found_) found_ = momenta_;
    if (!rows_.read(rows, momenta_) && solved_) return;
  }
  solved_ = smooth_ || last;
  const bool held = tree_.parts()[0].kind != Kind::kFree;
  solve_motion(!solved_   ? kEnough
               : !smooth_ ? kPressed
               : held     ? kHeld
                          : kFree,
               !first && moves_as_found_, rows);
}

void TreeGroup::give_found(BodyRows& rows) {
  give(
      [&](std::size_t k) {
        const Tree::Momentum linear = tree_.momentum(k, change_[k]);
        return Tree::Momentum{found_[k].linear + linear.linear, found_[k].angular + linear.angular};
      },
      rows);
}

// Takes coordinates as near to the displacements of the bodies as joints allow, by their momenta.
void TreeGroup::follow(std::span<Tree::Coordinate> coordinates) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const auto& [shift, turn] = aside_[k];
    wanted_[k] = tree_.momentum(k, {shift - cross(turn, tree_.centre(k)), turn});
    wanted_[k].angular = moment(k, wanted_[k].angular);
    tree_.drive(k).change = tree_.drive(k).impulse = 0;
  }
  tree_.respond(wanted_, change_);
  tree_.advance(change_, 1, coordinates);
}

// To where the motion leads. part: of a sub-step that it takes.
void TreeGroup::move_in_tree(double part) {
  tree_.place(end_, next_);
  tree_.begin(next_);
  sum_impulses(smooth_ && intervals_ == 0 ? 0.5 * part : part);
  count_turns();
  now_.swap(next_);
  begin_ = end_;
  tree_.normalize(begin_);
}

void TreeGroup::count_turns() {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    if (tree_.parts()[k].kind != Kind::kHinge && !m.ruled) continue;
    if (m.ruled) {
      m.rate = mean_rate(k);
      m.coordinate += sign(k) * h_ * m.rate;
    } else {
      m.coordinate += sign(k) * 2 * arctangent(0.5 * h_ * rates_[k].along);
    }
  }
}

void TreeGroup::move(BodyRows& rows) {
  if (alone_) {
    move_in_tree(h_ / substep_);
    h_ = substep_;
    weight_ = 1;
    ++intervals_;
    return;
  }
  const bool displaced =
      smooth_ ? rows_.find_drifts(rows, h_, aside_) : rows_.find_displacements(rows, h_, aside_);
  rows_.read(rows, momenta_);
  if (displaced) {
    if (whirls_) tree_.factor(now_);  // by what impulses see
    follow(end_);
    const double per_time = 1 / h_;
    for (std::size_t k = 0; k < members_.size(); ++k) {
      rates_[k].linear += per_time * change_[k].linear;
      rates_[k].angular += per_time * change_[k].angular;
      rates_[k].along += per_time * change_[k].along;
    }
  }
  tree_.place(end_, next_);
  tree_.find_turns(next_, turns_);
  sum_impulses(smooth_ && intervals_ == 0 ? 0.5 : 1);
  count_turns();
  rows_.show_places(next_, turns_, rows);
  now_.swap(next_);
  begin_ = end_;
  tree_.normalize(begin_);
  rows_.show_spins(tree_, momenta_, rows);
  weight_ = 1;
  ++intervals_;
}

// From the ends to the root: a joint holds all that hangs from it. weight: of the sub-step, 0 for
// none.
void TreeGroup::sum_impulses(double weight) {
  for (std::size_t k = members_.size(); k-- > 0;) {
    Member& m = members_[k];
    m.sum_along += m.along;
    if (weight > 0) m.last = m.along / weight;
    Tree::Momentum& own = given_[k];
    own.angular += cross(now_[k].c, own.linear);
    m.sum.linear += own.linear;
    m.sum.angular += own.angular;
    if (slides(k) && !m.is_a) m.sum.angular += cross(begin_[k].way * now_[k].axis, own.linear);
    if (weight > 0) m.impulse = {1 / weight * own.linear, 1 / weight * own.angular};
    if (const std::int32_t parent = tree_.parts()[k].parent; parent >= 0) {
      // About the parent's centre, as what it was given itself.
      Tree::Momentum& to = given_[usize(parent)];
      to.linear += own.linear;
      to.angular += own.angular + cross(now_[k].d - now_[usize(parent)].c, own.linear);
    }
    own = {};
  }
}

void TreeGroup::end_step(BodyRows& rows) {
  if (!smooth_) return;
  if (!alone_) rows_.read(rows, momenta_);
  kick(0.5 * h_, rows);
  weight_ = 0.5;
  last_rates_ = rates_;
  set_laws(Stage::kVelocity);
  project();
  if (slow_springs(Stage::kVelocity, change_)) project();
  give([&](std::size_t k) { return tree_.momentum(k, change_[k]); }, rows);
  sum_impulses(0);
  if (!alone_) return;
  rows_.show(tree_, momenta_, rows);
  rows_.end_step(now_, rows);
}

void TreeGroup::store(Bodies& bodies, std::span<Joint> joints, double dt) const {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    store_quaternion(Quaternion(now_[k].R.dense()).normalized(), &bodies.q[4 * usize(m.body)]);
    Vec3::Map(&bodies.L[3 * usize(m.body)]) = vec(momenta_[k].angular);
  }
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (m.joint < 0) continue;
    Joint& joint = joints[usize(m.joint)];
    const double sign = this->sign(k);
    joint.force = sign / dt * vec(m.sum.linear);
    joint.torque = sign / dt * vec(m.sum.angular);
    joint.effort = m.ruled ? m.sum_along / dt : 0;
    joint.length_error = joint.angle_error = 0;
    joint.impulse.fill(0);
    Vec3::Map(joint.impulse.data()) = sign * vec(m.impulse.linear);
    const Quaternion axes =
        (joint.b < 0 ? Quaternion::Identity() : bodies.rotation(joint.b)) * joint.in_b.axes;
    const Vec3 torque = axes.conjugate() * Vec3(sign * vec(m.impulse.angular));
    if (joint.type == JointType::kHinge) {
      joint.impulse[3] = torque[1], joint.impulse[4] = torque[2];
      joint.coordinate = coordinate(k);
      if (!m.ruled) continue;
      joint.impulse[5] = m.last;
      joint.angle_error = std::abs(passed(k));
    } else if (joint.type == JointType::kSlider) {
      const Vec3 force = axes.conjugate() * Vec3(sign * vec(m.impulse.linear));
      joint.impulse = {force[1], force[2], torque[0], torque[1], torque[2], m.last};
      joint.coordinate = coordinate(k);
      joint.length_error = std::abs(passed(k));
    } else if (joint.type == JointType::kFixed) {
      Vec3::Map(&joint.impulse[3]) = torque;
    } else {
      joint.coordinate = joint_coordinate(joint, bodies);
    }
  }
}

}  // namespace substep::rigid
