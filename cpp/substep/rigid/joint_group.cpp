#include "substep/rigid/joint_group.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace substep::rigid {
namespace {

using Mode = JointLaw::Mode;

constexpr int kIterations = 12;
constexpr double kTolerance = 1e-12;  // of C [m], [rad]
constexpr double kEnough = 1e-6;      // the same where it does not get better
constexpr double kPositions = 1e-10;  // C that is not worth taking back
// E, relative to the diagonal, where loops may have more equations than motions, and in trees. It
// acts on all of l, which so is as small as can be; joints yield by this part of what they hold,
// and take it back.
constexpr double kLoops = 1e-8, kTrees = 1e-14;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }
Vec3 from_row(const Point<double>& p) { return {p.x, p.y, p.z}; }
void add(Point<double>& p, const Vec3& v) { p.x += v.x(), p.y += v.y(), p.z += v.z(); }
void assign(Point<double>& p, const Vec3& v) { p.x = v.x(), p.y = v.y(), p.z = v.z(); }
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
    const Joint& joint = joints[at(number)];
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
  for (const Link& link : links_) pairs.push_back({place[at(link.a)], place[at(link.b)]});
  matrix_.analyse(moving, pairs, sizes);
  // A tree has one node, of bodies or the ground, more than joints.
  const bool grounded = std::any_of(pairs.begin(), pairs.end(),
                                    [](const BodyPair& pair) { return pair.a < 0 || pair.b < 0; });
  const bool tree = links_.size() + 1 == at(moving) + (grounded ? 1 : 0);
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
    const Vec3 I = still ? Vec3::Ones() : Vec3(&bodies.inertia[3 * at(m.body)]);
    m.unroot = conjugated(m.now.q, I.cwiseSqrt());
    Vec3::Map(&inertia_[3 * k]) = I;
    Vec3::Map(&L_[3 * k]) = still ? Vec3::Zero() : Vec3(&bodies.L[3 * at(m.body)]);
    m.seen_spin = from_row(rows.velocity[at(m.row)].angular);
    m.seen_turn = m.given_v = m.given_w = m.start = m.start_turn = Vec3::Zero();
    refresh(k, rows);
    if (m.moves && pressed[at(m.body)] != 0) smooth_ = false;
  }
  for (Link& link : links_) {
    link.joint = joints[at(link.number)];
    link.mode.fill(Mode::kFree);
    link.force = link.torque = Vec3::Zero();
  }
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
  assign(rows.velocity[at(m.row)].angular, m.seen_spin);
}

// Forces alone, for a time that may be negative.
void JointGroup::kick(double time, BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (!m.moves) continue;
    const BodyRow& a = rows.acceleration[at(m.row)];
    add(rows.velocity[at(m.row)].linear, time * from_row(a.linear));
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
    if (from_row(rows.velocity[at(m.row)].linear) != m.seen_velocity) changed = true;
    const Vec3 spin = from_row(rows.velocity[at(m.row)].angular);
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
    Point<double>& row = rows.velocity[at(m.row)].angular;
    m.given_w += spin - from_row(row);
    assign(row, spin);
    m.seen_spin = spin;
  }
}

// Call write_momenta() afterwards.
void JointGroup::apply(Link& link, int row, double impulse, BodyRows& rows) {
  link.impulse[at(row)] += impulse;
  tried_ = false;
  const auto give = [&](std::int32_t member, double l, const Vec3& angular) {
    Member& m = members_[at(member)];
    if (!m.moves) return;
    const Vec3 v = l * m.scale * link.G.linear[row];
    add(rows.velocity[at(m.row)].linear, v);
    m.given_v += v;
    Vec3::Map(&L_[3 * at(member)]) += l * angular;
  };
  give(link.a, impulse, link.G.angular_a[row]);
  give(link.b, -impulse, link.G.angular_b[row]);
}

void JointGroup::begin_substep(BodyRows& rows) {
  tried_ = false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    const BodyRow &x = rows.displacement[at(m.row)], &free = rows.free[at(m.row)];
    const BodyRow& a = rows.acceleration[at(m.row)];
    // The half kick back that begins a step is none of what was before it.
    const double kicked = settings_.h - weight_ * settings_.h;
    m.v_before = m.scale * (from_row(free.linear) - weight_ * settings_.h * from_row(a.linear));
    m.w_before = m.W * (momentum(k) + kicked * (m.unroot * from_row(a.angular)));
    m.start = from_row(x.linear);
    m.start_turn = from_row(x.angular);
    if (!m.moves) continue;
    BodyRow& v = rows.velocity[at(m.row)];
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
  set_gradients();
  for (Link& link : links_) {
    set_laws(link, Stage::kMotion);
    link.impulse.fill(0);
    for (int row = 0; row < link.rows; ++row)
      apply(link, row, weight_ * link.joint.impulse[at(row)], rows);
  }
  write_momenta(rows);
}

std::array<double, kJointRows> JointGroup::values(const Link& link, bool trial) const {
  const auto side = [&](const Joint::Frame& frame, std::int32_t member) {
    const Place& place = trial ? trial_[at(member)] : members_[at(member)].now;
    return JointSide(frame, place.x, place.q);
  };
  return joint_values(link.joint.type, side(link.joint.in_a, link.a), side(link.joint.in_b, link.b),
                      link.joint.coordinate, !trial || link.rows > link.equations);
}

void JointGroup::set_gradients() {
  for (Link& link : links_) {
    const Member &a = members_[at(link.a)], &b = members_[at(link.b)];
    link.G = joint_gradients(link.joint.type, JointSide(link.joint.in_a, a.now.x, a.now.q),
                             JointSide(link.joint.in_b, b.now.x, b.now.q));
    link.begin = values(link, false);
    for (int row = 0; row < link.rows; ++row) {
      const auto of = [&](const Member& m, const Vec3& angular) {
        return m.moves ? m.scale * m.scale * link.G.linear[row].squaredNorm() +
                             angular.dot(m.W * angular)
                       : 0;
      };
      link.mobility[at(row)] = of(a, link.G.angular_a[row]) + of(b, link.G.angular_b[row]);
    }
  }
  factored_ = false;
}

double JointGroup::rate(const Link& link, int row, const BodyRows& rows) const {
  const Member &a = members_[at(link.a)], &b = members_[at(link.b)];
  const Vec3 v = a.scale * from_row(rows.velocity[at(a.row)].linear) -
                 b.scale * from_row(rows.velocity[at(b.row)].linear);
  return link.G.linear[row].dot(v) + link.G.angular_a[row].dot(a.W * momentum(at(link.a))) -
         link.G.angular_b[row].dot(b.W * momentum(at(link.b)));
}

double JointGroup::rate_before(const Link& link, int row) const {
  const Member &a = members_[at(link.a)], &b = members_[at(link.b)];
  return link.G.linear[row].dot(a.v_before - b.v_before) + link.G.angular_a[row].dot(a.w_before) -
         link.G.angular_b[row].dot(b.w_before);
}

// Limits that are passed already are no bias: they are for solve_positions().
void JointGroup::set_laws(Link& link, Stage stage) {
  const double h = settings_.h;
  const Joint& joint = link.joint;
  for (int row = link.equations; row < link.rows; ++row) {
    const std::size_t k = at(row - link.equations);
    const double y = link.begin[at(row)];
    const bool own = row == coordinate_row(joint.type);
    const double lower = own ? joint.lower : -Joint::kInfinite;
    const double upper = own ? joint.upper : joint.cone;
    JointLaw& law = link.law[k];
    law = {};
    if (lower == upper) {
      law.slowest = law.fastest = 0;
    } else if (stage == Stage::kMotion) {
      law.slowest = std::min(lower - y, 0.) / h;
      law.fastest = std::max(upper - y, 0.) / h;
    } else {
      if (link.mode[k] == Mode::kLower) law.slowest = 0;
      if (link.mode[k] == Mode::kUpper) law.fastest = 0;
    }
    const Joint::Motor& motor = joint.motor;
    if (motor.type == MotorType::kNone || !own) continue;
    law.driven = true;
    law.most = weight_ * h * motor.most;
    if (motor.type == MotorType::kSpeed) {
      law.rate = motor.target;
    } else {
      // The half kick that begins a step damps what the last one left, u, as long as that does not
      // turn it back: then both together are of second order.
      const double mass = 1 / link.mobility[at(row)], half = 0.5 * h * motor.damping;
      const bool begins = stage == Stage::kMotion && weight_ < 1;
      const double D =
          std::max(0.25 * h * h * motor.stiffness + (begins ? std::max(half - mass, 0.) : half),
                   1e-6 * mass);
      const double u = rate_before(link, row);
      const double impulse =
          -weight_ * h * (motor.stiffness * (y - motor.target) + motor.damping * u);
      law.rate = u + impulse / D;
      law.compliance = 1 / D;
    }
  }
}

// Where the velocities lead to.
void JointGroup::find_trial(const BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    m.seen_velocity = from_row(rows.velocity[at(m.row)].linear);
    trial_[k].x = m.origin + m.scale * (m.start + settings_.h * m.seen_velocity);
    store_quaternion(m.now.q, &q_[4 * k]);
  }
  rotate_rows(settings_.method, static_cast<std::int64_t>(members_.size()), q_.data(), L_.data(),
              inertia_.data(), settings_.h);
  for (std::size_t k = 0; k < members_.size(); ++k) trial_[k].q = load_quaternion(&q_[4 * k]);
  tried_ = true;
}

void JointGroup::choose_modes(Stage stage, BodyRows& rows, bool& changed, bool& applied) {
  for (Link& link : links_) {
    if (link.rows == link.equations) continue;
    std::array<double, kJointRows> C{};
    if (stage == Stage::kMotion) C = values(link, true);
    for (int row = link.equations; row < link.rows; ++row) {
      const std::size_t k = at(row - link.equations);
      const double u = stage == Stage::kMotion ? (C[at(row)] - link.begin[at(row)]) / settings_.h
                                               : rate(link, row, rows);
      const Mode mode = link.law[k].mode(u, link.impulse[at(row)], link.mobility[at(row)]);
      if (mode != link.mode[k]) changed = true;
      link.mode[k] = mode;
      if (!JointLaw::fixes_impulse(mode)) continue;
      const double change = link.law[k].fixed_impulse(mode) - link.impulse[at(row)];
      if (change == 0) continue;
      apply(link, row, change, rows);
      applied = true;
    }
  }
  if (applied) write_momenta(rows);
}

// The largest error of C at the end of the sub-step.
double JointGroup::find_residuals(Stage stage, const BodyRows& rows) {
  double worst = 0;
  for (std::size_t j = 0; j < links_.size(); ++j) {
    const Link& link = links_[j];
    std::array<double, kJointRows> C{};
    if (stage == Stage::kMotion) C = values(link, true);
    pieces_[j].fill(0);
    for (int row = 0; row < link.rows; ++row) {
      if (!link.active(row)) continue;
      double u = stage == Stage::kMotion ? (C[at(row)] - link.begin[at(row)]) / settings_.h
                                         : rate(link, row, rows);
      if (row >= link.equations) {
        const std::size_t k = at(row - link.equations);
        u = link.law[k].residual(link.mode[k], u, link.impulse[at(row)]);
      }
      u += regularisation_ * link.mobility[at(row)] * link.impulse[at(row)];
      pieces_[j][at(row)] = u;
      worst = std::max(worst, settings_.h * std::abs(u));
    }
  }
  return worst;
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
      double E = regularisation_ * link.mobility[at(row)];
      if (row >= link.equations) {
        const std::size_t k = at(row - link.equations);
        E += link.law[k].softness(link.mode[k]);
      }
      matrix_.set(static_cast<std::int32_t>(j), row,
                  piece(members_[at(link.a)], 1, row, link.G.angular_a[row]),
                  piece(members_[at(link.b)], -1, row, link.G.angular_b[row]), E);
    }
  }
  matrix_.factor();
  factored_ = true;
}

// Newton's method; ends where rounding does. Returns whether it has found the solution.
bool JointGroup::iterate(Stage stage, BodyRows& rows) {
  double last = Joint::kInfinite;
  for (int k = 0; k < kIterations; ++k) {
    bool changed = false, applied = false;
    if (stage == Stage::kMotion) find_trial(rows);
    choose_modes(stage, rows, changed, applied);
    if (applied && stage == Stage::kMotion) find_trial(rows);
    const double worst = find_residuals(stage, rows);
    if (!changed && (worst < kTolerance || (k > 2 && worst > 0.5 * last && worst < kEnough)))
      return true;
    last = worst;
    if (changed || !factored_) factor();
    matrix_.solve(pieces_);
    for (std::size_t j = 0; j < links_.size(); ++j) {
      for (int row = 0; row < links_[j].rows; ++row) {
        if (links_[j].active(row)) apply(links_[j], row, pieces_[j][at(row)], rows);
      }
    }
    write_momenta(rows);
  }
  return last < kEnough;
}

// Where no motion that fulfils the constraints is near (a chain that snaps taut), the velocities
// do, which takes energy and so is stable.
void JointGroup::solve_motion(BodyRows& rows) {
  if (iterate(Stage::kMotion, rows)) return;
  for (Link& link : links_) {
    for (int row = 0; row < link.rows; ++row) apply(link, row, -link.impulse[at(row)], rows);
    link.impulse.fill(0);
  }
  write_momenta(rows);
  iterate(Stage::kVelocity, rows);
}

void JointGroup::solve_velocities(BodyRows& rows, bool first) {
  if (first) {
    begin_substep(rows);
  } else if (!read_momenta(rows) && tried_) {
    return;
  }
  solve_motion(rows);
}

void JointGroup::sum_impulses(Link& link) const {
  const Vec3 arm = members_[at(link.a)].now.q * link.joint.in_a.anchor;
  for (int row = 0; row < link.rows; ++row) {
    const Vec3 l = link.impulse[at(row)] * link.G.linear[row];
    link.force += l;
    link.torque += link.impulse[at(row)] * link.G.angular_a[row] - arm.cross(l);
  }
}

void JointGroup::move(BodyRows& rows) {
  if (read_momenta(rows) || !tried_) find_trial(rows);
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    if (m.moves) {
      const BodyRow& v = rows.velocity[at(m.row)];
      BodyRow& x = rows.displacement[at(m.row)];
      assign(x.linear, m.start + settings_.h * from_row(v.linear));
      m.seen_turn = m.start_turn + settings_.h * from_row(v.angular);
      assign(x.angular, m.seen_turn);
    }
  }
  for (Link& link : links_) {
    sum_impulses(link);
    for (int row = 0; row < link.rows; ++row)
      link.joint.impulse[at(row)] = link.impulse[at(row)] / weight_;
  }
  for (std::size_t k = 0; k < members_.size(); ++k) members_[k].now = trial_[k];
  weight_ = 1;
}

void JointGroup::solve_positions(BodyRows& rows) {
  for (Member& m : members_) {
    const BodyRow& x = rows.displacement[at(m.row)];
    m.now.x = m.origin + m.scale * from_row(x.linear);
    if (!m.moves) continue;
    const Vec3 turn = from_row(x.angular);
    if (turn != m.seen_turn) {  // by contacts
      m.now.q = (rotation_by(m.root * (turn - m.seen_turn)) * m.now.q).normalized();
    }
  }
  double worst = 0;
  for (std::size_t j = 0; j < links_.size(); ++j) {
    Link& link = links_[j];
    const auto C = values(link, false);
    const int own = coordinate_row(link.joint.type);
    if (own >= 0) link.joint.coordinate = C[at(own)];
    pieces_[j].fill(0);
    for (int row = 0; row < link.rows; ++row) {
      double c = C[at(row)];
      if (row >= link.equations) {
        const Mode mode = link.mode[at(row - link.equations)];
        if (mode != Mode::kLower && mode != Mode::kUpper) continue;
        const double upper = row == own ? link.joint.upper : link.joint.cone;
        c -= mode == Mode::kLower ? link.joint.lower : upper;
      }
      pieces_[j][at(row)] = std::clamp(c, -settings_.push, settings_.push);
      worst = std::max(worst, std::abs(c));
    }
  }
  if (worst > kPositions) {
    if (!factored_) factor();
    matrix_.solve(pieces_);
    std::vector<Vec3> shift(members_.size(), Vec3::Zero()), turn = shift;
    for (std::size_t j = 0; j < links_.size(); ++j) {
      const Link& link = links_[j];
      for (int row = 0; row < link.rows; ++row) {
        if (!link.active(row)) continue;
        const double l = pieces_[j][at(row)];
        shift[at(link.a)] += l * link.G.linear[row];
        turn[at(link.a)] += l * link.G.angular_a[row];
        shift[at(link.b)] -= l * link.G.linear[row];
        turn[at(link.b)] -= l * link.G.angular_b[row];
      }
    }
    double largest = settings_.push;
    for (std::size_t k = 0; k < members_.size(); ++k) {
      const Member& m = members_[k];
      shift[k] *= m.scale;
      turn[k] = m.W * turn[k];
      if (m.moves) largest = std::max({largest, m.scale * shift[k].norm(), turn[k].norm()});
    }
    const double part = settings_.push / largest;
    for (std::size_t k = 0; k < members_.size(); ++k) {
      Member& m = members_[k];
      if (!m.moves) continue;
      BodyRow& x = rows.displacement[at(m.row)];
      const Vec3 angle = part * turn[k];
      add(x.linear, part * shift[k]);
      add(x.angular, m.unroot * angle);
      m.now.x = m.origin + m.scale * from_row(x.linear);
      m.now.q = (rotation_by(angle) * m.now.q).normalized();
    }
  }
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    m.seen_turn = from_row(rows.displacement[at(m.row)].angular);
    refresh(k, rows);
  }
}

void JointGroup::end_step(BodyRows& rows) {
  if (smooth_) {
    for (std::size_t k = 0; k < members_.size(); ++k) {
      Member& m = members_[k];
      m.v_before = m.scale * from_row(rows.velocity[at(m.row)].linear);
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
    store_quaternion(m.now.q, &bodies.q[4 * at(m.body)]);
    Vec3::Map(&bodies.L[3 * at(m.body)]) = momentum(k);
  }
  for (const Link& link : links_) {
    Joint& joint = joints[at(link.number)];
    const auto C = values(link, false);
    joint.impulse = link.joint.impulse;
    joint.coordinate = link.joint.coordinate;
    joint.force = link.force / dt;
    joint.torque = link.torque / dt;
    joint.length_error = joint.angle_error = 0;
    for (int row = 0; row < link.rows; ++row) {
      double error = C[at(row)];
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
