#include "substep/rigid/solver/joint_group.h"

#include <algorithm>
#include <cmath>

#include "substep/core/usize.h"
#include "substep/rigid/motion/row_vectors.h"

namespace substep::rigid {
namespace {

// E, relative to the diagonal, where loops may have more equations than motions, and in trees. It
// acts on all of l, which so is as small as can be; joints yield by this part of what they hold,
// and take it back.
constexpr double kLoops = 1e-8, kTrees = 1e-14;
// Most of h w where contacts press, and elsewhere.
constexpr double kSwing = 0.5, kFreeSwing = 1.5;

Mat3 conjugated(const Quaternion& q, const Vec3& D) {
  const Mat3 R = q.toRotationMatrix();
  return R * D.asDiagonal() * R.transpose();
}

}  // namespace

JointGroup::JointGroup(std::vector<std::int32_t> numbers, std::span<const Joint> joints,
                       const BodyRows& rows) {
  std::vector<BodyPair> pairs;
  std::vector<int> sizes;
  for (const std::int32_t number : numbers) {
    const Joint& joint = joints[usize(number)];
    Link link;
    link.number = number;
    link.a = member_of(joint.a, rows);
    link.b = member_of(joint.b, rows);
    link.equations = joint_equations(joint.type);
    link.rows = joint_rows(joint);
    links_.push_back(link);
    sizes.push_back(link.rows);
  }
  std::vector<std::int32_t> place(members_.size(), -1);  // among those that impulses move
  std::int32_t moving = 0;
  for (std::size_t k = 0; k < members_.size(); ++k)
    if (members_[k].moves) place[k] = moving++;
  for (const Link& link : links_) pairs.push_back({place[usize(link.a)], place[usize(link.b)]});
  matrix_.analyse(moving, pairs, sizes);
  // A tree has one node, of bodies or the ground, more than joints.
  const bool grounded = std::any_of(pairs.begin(), pairs.end(),
                                    [](const BodyPair& pair) { return pair.a < 0 || pair.b < 0; });
  const bool tree = links_.size() + 1 == usize(moving) + (grounded ? 1 : 0);
  regularisation_ = tree ? kTrees : kLoops;
  pieces_.resize(links_.size());
  q_.resize(4 * members_.size());
  L_.resize(3 * members_.size());
  inertia_.resize(3 * members_.size());
  trial_.resize(members_.size());
}

std::int32_t JointGroup::member_of(std::int32_t body, const BodyRows& rows) {
  const auto found = std::find_if(members_.begin(), members_.end(),
                                  [&](const Member& m) { return m.body == body; });
  if (found != members_.end()) return static_cast<std::int32_t>(found - members_.begin());
  Member member;
  member.body = body;
  member.moves = rows.moves(rows.row(body));
  members_.push_back(member);
  return static_cast<std::int32_t>(members_.size()) - 1;
}

void JointGroup::begin_step(std::span<const Joint> joints, std::span<const std::uint8_t> pressed,
                            const Bodies& bodies, const Settings& settings, BodyRows& rows) {
  settings_ = settings;
  smooth_ = true;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    m.row = rows.row(m.body);
    m.scale = rows.scale_of(m.row);
    m.root = rows.root_of(m.row);
    m.origin = m.body < 0 ? Vec3::Zero() : bodies.position(m.body);
    m.now = {m.origin, m.body < 0 ? Quaternion::Identity() : bodies.rotation(m.body)};
    const bool still = m.row == 0;
    const Vec3 I = still ? Vec3::Ones() : Vec3(&bodies.inertia[3 * usize(m.body)]);
    m.unroot = conjugated(m.now.q, I.cwiseSqrt());
    m.inertia = I;
    Vec3::Map(&inertia_[3 * k]) = I;
    Vec3::Map(&L_[3 * k]) = still ? Vec3::Zero() : Vec3(&bodies.L[3 * usize(m.body)]);
    m.seen_spin = from_row(rows.velocity[usize(m.row)].angular);
    m.seen_turn = m.given_v = m.given_w = m.start = m.start_turn = Vec3::Zero();
    refresh(k, rows);
    if (m.moves && pressed[usize(m.body)] != 0) smooth_ = false;
  }
  for (Link& link : links_) {
    link.joint = joints[usize(link.number)];
    link.mode.fill(JointLaw::Mode::kFree);
    link.force = link.torque = Vec3::Zero();
    link.effort = 0;
  }
  find_inertia();
  weight_ = smooth_ ? 0.5 : 1;
  if (smooth_) kick(-0.5 * settings_.h, rows);
}

// What is due to the rotation of a member.
void JointGroup::refresh(std::size_t member, BodyRows& rows) {
  Member& m = members_[member];
  const Vec3 I(&inertia_[3 * member]);
  m.W_root = m.row == 0 ? Mat3::Zero().eval() : conjugated(m.now.q, I.cwiseSqrt().cwiseInverse());
  m.W = m.W_root * m.W_root;
  if (!m.moves) return;
  m.seen_spin = m.unroot * (m.W * momentum(member));
  assign(rows.velocity[usize(m.row)].angular, m.seen_spin);
}

// Forces alone, for a time that may be negative.
void JointGroup::kick(double time, BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (!m.moves) continue;
    const BodyRow& a = rows.acceleration[usize(m.row)];
    add(rows.velocity[usize(m.row)].linear, time * from_row(a.linear));
    Vec3::Map(&L_[3 * k]) += time * (m.unroot * from_row(a.angular));
    refresh(k, rows);
  }
}

// Returns whether the velocities are others than those of the trial.
bool JointGroup::read_momenta(const BodyRows& rows) {
  bool changed = false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    if (!m.moves) continue;
    if (from_row(rows.velocity[usize(m.row)].linear) != m.seen_velocity) changed = true;
    const Vec3 spin = from_row(rows.velocity[usize(m.row)].angular);
    if (spin == m.seen_spin) continue;
    Vec3::Map(&L_[3 * k]) += m.unroot * (spin - m.seen_spin);
    m.seen_spin = spin;
    changed = true;
  }
  return changed;
}

void JointGroup::write_momenta(BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    if (!m.moves) continue;
    const Vec3 spin = m.unroot * (m.W * momentum(k));
    Point<double>& row = rows.velocity[usize(m.row)].angular;
    m.given_w += spin - from_row(row);
    assign(row, spin);
    m.seen_spin = spin;
  }
}

// Call write_momenta() afterwards.
void JointGroup::apply(Link& link, const Impulses& change, BodyRows& rows) {
  tried_ = false;
  Vec3 linear = Vec3::Zero(), angular_a = linear, angular_b = linear;
  for (int row = 0; row < link.rows; ++row) {
    const double l = change[usize(row)];
    link.impulse[usize(row)] += l;
    linear += l * link.G.linear[row];
    angular_a += l * link.G.angular_a[row];
    angular_b += l * link.G.angular_b[row];
  }
  const auto give = [&](std::int32_t member, const Vec3& impulse, const Vec3& angular) {
    Member& m = members_[usize(member)];
    if (!m.moves) return;
    const Vec3 v = m.scale * impulse;
    add(rows.velocity[usize(m.row)].linear, v);
    m.given_v += v;
    Vec3::Map(&L_[3 * usize(member)]) += angular;
  };
  give(link.a, linear, angular_a);
  give(link.b, -linear, -angular_b);
}

std::array<double, kJointRows> JointGroup::values(const Link& link, bool trial) const {
  const auto side = [&](const Joint::Frame& frame, std::int32_t member) {
    const Place& place = trial ? trial_[usize(member)] : members_[usize(member)].now;
    return JointSide(frame, place.x, place.q);
  };
  return joint_values(link.joint.type, side(link.joint.in_a, link.a), side(link.joint.in_b, link.b),
                      link.joint.coordinate, !trial || link.rows > link.equations);
}

void JointGroup::set_gradients() {
  for (Link& link : links_) {
    const Member &a = members_[usize(link.a)], &b = members_[usize(link.b)];
    const JointSide side_a(link.joint.in_a, a.now.x, a.now.q);
    const JointSide side_b(link.joint.in_b, b.now.x, b.now.q);
    link.G = joint_gradients(link.joint.type, side_a, side_b);
    link.begin = joint_values(link.joint.type, side_a, side_b, link.joint.coordinate,
                              link.rows > link.equations);
    for (int row = 0; row < link.rows; ++row) {
      const auto of = [&](const Member& m, const Vec3& angular) {
        return m.moves ? m.scale * m.scale * link.G.linear[row].squaredNorm() +
                             angular.dot(m.W * angular)
                       : 0;
      };
      link.mobility[usize(row)] = of(a, link.G.angular_a[row]) + of(b, link.G.angular_b[row]);
    }
  }
  factored_ = false;
}

void JointGroup::factor() {
  matrix_.clear();
  for (std::size_t j = 0; j < links_.size(); ++j) {
    const Link& link = links_[j];
    const auto piece = [&](const Member& m, double sign, int row, const Vec3& angular) {
      JointMatrix::Piece p;
      Vec3::Map(p.data()) = sign * m.scale * link.G.linear[row];
      Vec3::Map(p.data() + 3) = sign * (m.W_root * angular);
      return p;
    };
    for (int row = 0; row < link.rows; ++row) {
      if (!link.active(row)) continue;
      double E = regularisation_ * link.mobility[usize(row)];
      if (row >= link.equations) {
        const std::size_t k = usize(row - link.equations);
        E += link.law[k].softness(link.mode[k]);
      }
      matrix_.set(static_cast<std::int32_t>(j), row,
                  piece(members_[usize(link.a)], 1, row, link.G.angular_a[row]),
                  piece(members_[usize(link.b)], -1, row, link.G.angular_b[row]), E);
    }
  }
  matrix_.factor();
  factored_ = true;
}

// Forces f at arms r turn a body back into their direction, by K = r . f: a link of a rope that
// holds a heavy load swings about its centre at w = sqrt(K / I). That is unstable from h w = 2 on,
// so its moments in a sub-step are at least those of a smaller h w; no others change (Andrews,
// Teichmann and Kovecses 2017, Comput. Animat. Virtual Worlds 28).
void JointGroup::find_inertia() {
  struct Arms {
    Vec3 K = Vec3::Zero(), sum = Vec3::Zero();
    double weight = 0;
  };
  std::vector<Arms> arms(members_.size());
  for (const Link& link : links_) {
    if (link.joint.type == JointType::kSlider || link.joint.type == JointType::kDistance) continue;
    const Vec3 force = Vec3(link.joint.impulse.data()) / settings_.h;
    const auto add = [&](std::int32_t member, const Vec3& r, const Vec3& f) {
      const double K = r.dot(members_[usize(member)].now.q.conjugate() * f);
      if (!(K > 0)) return;
      Arms& arm = arms[usize(member)];
      arm.K += K * (Vec3::Ones() - r.cwiseAbs2() / r.squaredNorm());
      arm.sum += K * r, arm.weight += K;
    };
    add(link.a, link.joint.in_a.anchor, force);
    add(link.b, link.joint.in_b.anchor, -force);
  }
  const double most = smooth_ ? kFreeSwing : kSwing;
  whirls_ = false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    m.slow_inertia = m.inertia;
    if (!m.moves || !(arms[k].weight > 0)) continue;
    // What hangs at one end swings about it.
    const Vec3 r = 1 / m.scale * arms[k].sum / arms[k].weight;
    const Vec3 about_end = Vec3::Constant(r.squaredNorm()) - r.cwiseAbs2();
    const Vec3 least = settings_.h * settings_.h / (most * most) * arms[k].K - about_end;
    m.slow_inertia = m.inertia.cwiseMax(least);
    whirls_ |= m.slow_inertia != m.inertia;
  }
}

void JointGroup::mark_bodies(std::span<std::uint8_t> bodies) const {
  for (const Member& m : members_)
    if (m.moves) bodies[usize(m.body)] = 1;
}

// Takes energy: larger moments have the momentum, smaller ones the angular velocity that was.
void JointGroup::set_inertia(std::size_t member, const Vec3& inertia, BodyRows& rows) {
  Eigen::Map<Vec3> now(&inertia_[3 * member]), L(&L_[3 * member]);
  if (now == inertia) return;
  const Quaternion& q = members_[member].now.q;
  L = q * (q.conjugate() * L).cwiseProduct(inertia.cwiseQuotient(now).cwiseMin(1));
  now = inertia;
  refresh(member, rows);
}

void JointGroup::begin_substep(BodyRows& rows) {
  tried_ = false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    const BodyRow &x = rows.displacement[usize(m.row)], &free = rows.free[usize(m.row)];
    const BodyRow& a = rows.acceleration[usize(m.row)];
    // The half kick back that begins a step is none of what was before it.
    const double kicked = settings_.h - weight_ * settings_.h;
    m.v_before = m.scale * (from_row(free.linear) - weight_ * settings_.h * from_row(a.linear));
    m.w_before = m.W * (momentum(k) + kicked * (m.unroot * from_row(a.angular)));
    m.start = from_row(x.linear);
    m.start_turn = from_row(x.angular);
    if (!m.moves) continue;
    BodyRow& v = rows.velocity[usize(m.row)];
    add(v.linear, -m.given_v);
    add(v.angular, -m.given_w);
    m.given_v = m.given_w = Vec3::Zero();
  }
  read_momenta(rows);
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    m.now.x = m.origin + m.scale * m.start;
    if (!m.moves || m.start_turn == m.seen_turn) continue;  // else by an impact
    m.now.q = (rotation_by(m.root * (m.start_turn - m.seen_turn)) * m.now.q).normalized();
    m.seen_turn = m.start_turn;
    refresh(k, rows);
  }
  find_inertia();
  for (std::size_t k = 0; k < members_.size(); ++k) set_inertia(k, members_[k].slow_inertia, rows);
  set_gradients();
  for (Link& link : links_) {
    set_laws(link, Stage::kMotion);
    link.impulse.fill(0);
    Impulses first = link.joint.impulse;
    for (double& l : first) l *= weight_;
    apply(link, first, rows);
  }
  write_momenta(rows);
}

void JointGroup::sum_impulses(Link& link) const {
  const Vec3 arm = rotated(members_[usize(link.a)].now.q, link.joint.in_a.anchor);
  for (int row = 0; row < link.rows; ++row) {
    const Vec3 l = link.impulse[usize(row)] * link.G.linear[row];
    link.force += l;
    link.torque += link.impulse[usize(row)] * link.G.angular_a[row] - arm.cross(l);
  }
  const int own = coordinate_row(link.joint.type);
  if (own >= 0 && own < link.rows) link.effort += link.impulse[usize(own)];
}

// A force at the anchor turns with the bodies: the next sub-step begins with it, and across a long
// arm of a light body the part of it that stayed behind would whirl the body around. It turns with
// the one that it would whirl more.
void JointGroup::turn_impulse(Link& link) const {
  if (link.joint.type == JointType::kSlider || link.joint.type == JointType::kDistance) return;
  double weights = 0;
  Vec3 turn = Vec3::Zero();
  const auto add = [&](std::int32_t k, std::span<const Vec3> angular) {
    const Member& m = members_[usize(k)];
    if (!m.moves) return;
    double weight = 0;
    for (std::size_t i = 0; i < 3; ++i) weight += angular[i].dot(m.W * angular[i]);
    weights += weight;
    turn += weight * rotation_vector(trial_[usize(k)].q * m.now.q.conjugate());
  };
  add(link.a, link.G.angular_a);
  add(link.b, link.G.angular_b);
  if (!(weights > 0)) return;
  Eigen::Map<Vec3> force(link.joint.impulse.data());
  force = rotation_by(turn / weights) * force;
}

void JointGroup::move(BodyRows& rows) {
  if (read_momenta(rows) || !tried_) find_trial(rows);
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    if (m.moves) {
      const BodyRow& v = rows.velocity[usize(m.row)];
      m.seen_turn = m.start_turn + settings_.h * from_row(v.angular);
      if (!smooth_ && !whirls_) continue;  // what contacts push is displaced beside
      BodyRow& x = rows.displacement[usize(m.row)];
      assign(x.linear, m.start + settings_.h * from_row(v.linear));
      assign(x.angular, m.seen_turn);
    }
  }
  for (Link& link : links_) {
    sum_impulses(link);
    for (int row = 0; row < link.rows; ++row)
      link.joint.impulse[usize(row)] = link.impulse[usize(row)] / weight_;
    turn_impulse(link);
  }
  for (std::size_t k = 0; k < members_.size(); ++k) members_[k].now = trial_[k];
  weight_ = 1;
}

void JointGroup::end_step(BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) set_inertia(k, members_[k].inertia, rows);
  if (smooth_) {
    for (std::size_t k = 0; k < members_.size(); ++k) {
      Member& m = members_[k];
      m.v_before = m.scale * from_row(rows.velocity[usize(m.row)].linear);
      m.w_before = m.W * momentum(k);
    }
    kick(0.5 * settings_.h, rows);
    weight_ = 0.5;
    set_gradients();
    for (Link& link : links_) {
      set_laws(link, Stage::kVelocity);
      link.impulse.fill(0);
    }
    iterate(Stage::kVelocity, rows);
    for (Link& link : links_) sum_impulses(link);
  }
}

void JointGroup::store(Bodies& bodies, std::span<Joint> joints, double dt) const {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (!m.moves) continue;
    store_quaternion(m.now.q, &bodies.q[4 * usize(m.body)]);
    Vec3::Map(&bodies.L[3 * usize(m.body)]) = momentum(k);
  }
  for (const Link& link : links_) {
    Joint& joint = joints[usize(link.number)];
    const auto C = values(link, false);
    joint.impulse = link.joint.impulse;
    joint.coordinate = link.joint.coordinate;
    joint.force = link.force / dt;
    joint.torque = link.torque / dt;
    joint.effort = link.effort / dt;
    joint.length_error = joint.angle_error = 0;
    for (int row = 0; row < link.rows; ++row) {
      double error = C[usize(row)];
      if (row >= link.equations) {
        const bool own = row == coordinate_row(joint.type);
        const double upper = own ? joint.upper : joint.cone;
        error = std::max({0., error - upper, own ? joint.lower - error : 0.});
      }
      double& sum = link.G.linear[row].isZero(0) ? joint.angle_error : joint.length_error;
      sum = std::hypot(sum, error);
    }
  }
}

}  // namespace substep::rigid
