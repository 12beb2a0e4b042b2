#include "substep/rigid/solver/joint_group.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/point_scatter.h"
#include "substep/core/usize.h"
#include "substep/rigid/motion/row_vectors.h"

namespace substep::rigid {
namespace {

// E, relative to the diagonal, where loops may have more equations than motions, and in trees. It
// acts on all of l, which so is as small as can be; joints yield by this part of what they hold,
// and take it back. What hits a loop opens it, and no motion keeps all of the errors C of equations
// that ask for the same twice: there E is larger, and the motion leads to C = 0.
constexpr double kLoops = 1e-8, kTrees = 1e-14, kOpenLoops = 1e-5;
constexpr double kOpen = 1e-8;  // errors of a loop that was hit [m], [rad]

Mat3 conjugated(const Quaternion& q, const Vec3& D) {
  const Mat3 R = q.toRotationMatrix();
  return R * D.asDiagonal() * R.transpose();
}

}  // namespace

JointGroup::JointGroup(std::vector<std::int32_t> numbers, std::span<const Joint> joints,
                       const BodyRows& rows) {
  std::stable_sort(numbers.begin(), numbers.end(), [&](std::int32_t j, std::int32_t k) {
    return joints[usize(j)].type < joints[usize(k)].type;
  });
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
    link.joint = joint;
    has_laws_ |= link.rows > link.equations;
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
  loops_ = links_.size() + 1 > usize(moving) + (grounded ? 1 : 0);
  pack();
  pieces_.resize(links_.size());
  const std::size_t n = members_.size();
  L_.resize(3 * n);
  inertia_.resize(3 * n);
  for (AlignedBuffer<BodyRow>* rows_of : {&root_, &before_, &given_, &sums_}) rows_of->reset(n);
  for (Places* places : {&now_, &trial_}) places->x.reset(n), places->q.reset(n);
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

void JointGroup::pack() {
  for (std::size_t first = 0; first < links_.size();) {
    Pack pack{};
    pack.type = links_[first].joint.type;
    pack.equations = links_[first].equations;
    for (int lane = 0; lane < kLanes; ++lane) {
      std::size_t k = first + usize(lane);
      if (pack.count == lane && k < links_.size() && links_[k].joint.type == pack.type)
        ++pack.count;
      else
        k = first;
      const Link& link = links_[k];
      pack.link[lane] = static_cast<std::int32_t>(k);
      pack.a[lane] = link.a, pack.b[lane] = link.b;
      pack.rows = std::max(pack.rows, link.rows);
    }
    packs_.push_back(pack);
    first += usize(pack.count);
  }
}

void JointGroup::begin_step(std::span<const Joint> joints, std::span<const std::uint8_t> pressed,
                            const Bodies& bodies, const Settings& settings, BodyRows& rows) {
  settings_ = settings;
  smooth_ = true;
  bool open = false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    m.row = rows.row(m.body);
    m.scale = rows.scale_of(m.row);
    m.root = rows.root_of(m.row);
    m.origin = m.body < 0 ? Vec3::Zero() : bodies.position(m.body);
    const Quaternion q = m.body < 0 ? Quaternion::Identity() : bodies.rotation(m.body);
    const bool still = m.row == 0;
    const Vec3 I = still ? Vec3::Ones() : Vec3(&bodies.inertia[3 * usize(m.body)]);
    m.unroot = conjugated(q, I.cwiseSqrt());
    m.inertia = m.seen_inertia = I;
    Vec3::Map(&inertia_[3 * k]) = I;
    Vec3::Map(&L_[3 * k]) = still ? Vec3::Zero() : Vec3(&bodies.L[3 * usize(m.body)]);
    m.seen_spin = from_row(rows.velocity[usize(m.row)].angular);
    m.seen_turn = m.start = m.start_turn = Vec3::Zero();
    given_[k] = {};
    now_.x[k] = trial_.x[k] = {};
    assign(now_.x[k], m.origin);
    store_quaternion(q, &now_.q[k].x);
    refresh(k, rows);
    if (!m.moves) continue;
    if (pressed[usize(m.body)] == kPressed) smooth_ = false;
    if (pressed[usize(m.body)] != 0) open = true;
  }
  has_springs_ = false;
  for (Link& link : links_) {
    link.joint = joints[usize(link.number)];
    has_springs_ |= link.joint.type == JointType::kElastic ||
                    (link.joint.motor.type == MotorType::kSpring &&
                     is_turn(link.joint.type, coordinate_row(link.joint.type)));
    open |= std::max(link.joint.length_error, link.joint.angle_error) > kOpen;
    link.mode.fill(JointLaw::Mode::kFree);
  }
  for (Pack& pack : packs_) {
    pack.force = pack.torque = {};
    pack.effort = V{};
    for (int lane = 0; lane < kLanes; ++lane) {
      const Joint& joint = links_[usize(pack.link[lane])].joint;
      pack.in_a.set(lane, joint.in_a), pack.in_b.set(lane, joint.in_b);
      pack.coordinate[lane] = joint.coordinate;
      for (int row = 0; row < kJointRows; ++row) pack.last[row][lane] = joint.impulse[usize(row)];
    }
  }
  closes_ = loops_ && open;
  regularisation_ = closes_ ? kOpenLoops : loops_ ? kLoops : kTrees;
  begins_ = true;
  find_inertia(rows);
  weight_ = smooth_ ? 0.5 : 1;
  if (smooth_) kick(-0.5 * settings_.h, rows);
}

// What is due to the rotation of a member.
void JointGroup::refresh(std::size_t member, BodyRows& rows) {
  Member& m = members_[member];
  const auto root_of = [&](const Vec3& I) -> Mat3 {
    return m.row == 0 ? Mat3::Zero() : conjugated(rotation(member), I.cwiseSqrt().cwiseInverse());
  };
  Mat3 root = root_of(m.inertia);
  m.W = m.response = root * root;
  if (m.slow()) {
    root = root_of(m.seen_inertia);
    m.response = root * root;
    m.part = conjugated(rotation(member), m.inertia.cwiseQuotient(m.seen_inertia));
  }
  const double moves = m.moves ? 1 : 0;
  root_[member] = {{root(0, 0), root(1, 1), root(2, 2), m.scale},
                   {root(0, 1), root(0, 2), root(1, 2), moves}};
  if (!m.moves) return;
  m.seen_spin = m.unroot * (m.W * momentum(member));
  assign(rows.velocity[usize(m.row)].angular, m.seen_spin);
}

// The same within a sub-step: what it changes of the row is no push of contacts.
void JointGroup::refresh_within(std::size_t member, BodyRows& rows) {
  const Point<double>& spin = rows.velocity[usize(members_[member].row)].angular;
  const Vec3 before = from_row(spin);
  refresh(member, rows);
  if (members_[member].moves) add(given_[member].angular, from_row(spin) - before);
}

// Forces alone, for a time that may be negative.
void JointGroup::kick(double time, BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (!m.moves) continue;
    const BodyRow& a = rows.acceleration[usize(m.row)];
    add(rows.velocity[usize(m.row)].linear, time * from_row(a.linear));
    give(k, time * (m.unroot * from_row(a.angular)));
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
    give(k, m.unroot * (spin - m.seen_spin));
    m.seen_spin = spin;
    changed = true;
  }
  return changed;
}

void JointGroup::write_momenta(BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    if (!m.moves) continue;
    Point<double>& row = rows.velocity[usize(m.row)].angular;
    const Vec3 spin = m.unroot * (m.W * momentum(k));
    add(given_[k].angular, spin - from_row(row));
    assign(row, spin);
    m.seen_spin = spin;
  }
}

// Impulses and their moments about the centres, of the links of a pack.
JointGroup::Wrench JointGroup::wrench(const Pack& pack, const V* l) {
  JointVector force{}, torque{};
  for (int row = 0; row < pack.rows; ++row) {
    JointVector& sum = is_turn(pack.type, row) ? torque : force;
    sum = sum + l[row] * pack.G.axis[row];
  }
  return {force, cross(pack.G.arm_a, force) + torque, cross(pack.G.arm_b, force) + torque};
}

void JointGroup::load_pieces(const Pack& pack, V* l) const {
  const auto four = [&](int first) {
    return load_rows<V>([&](int lane) {
      return reinterpret_cast<const Point<double>*>(&pieces_[usize(pack.link[lane])]) + first;
    });
  };
  const auto low = four(0), high = four(1);
  l[0] = low.x, l[1] = low.y, l[2] = low.z, l[3] = low.w, l[4] = high.x, l[5] = high.y;
}

void JointGroup::store_pieces(const Pack& pack, const V* l) {
  const auto four = [&](int first, const V& x, const V& y, const V& z, const V& w) {
    store_rows<V>({x, y, z, w}, [&](int lane) {
      return reinterpret_cast<Point<double>*>(&pieces_[usize(pack.link[lane])]) + first;
    });
  };
  four(0, l[0], l[1], l[2], l[3]);
  four(1, l[4], l[5], V{}, V{});
}

// Adds the pieces to the impulses. Call write_momenta() afterwards.
void JointGroup::apply(BodyRows& rows) {
  tried_ = false;
  for (Pack& pack : packs_) {
    V l[kJointRows];
    load_pieces(pack, l);
    for (int row = 0; row < pack.rows; ++row) pack.impulse[row] += l[row];
    each_side(pack, wrench(pack, l), [&](std::size_t k, const auto& force, const auto& torque) {
      const Member& m = members_[k];
      if (!m.moves) return;
      const auto v = m.scale * force;
      Point<double>& row = rows.velocity[usize(m.row)].linear;
      store_quad(row, load_quad(row) + v);
      store_quad(given_[k].linear, load_quad(given_[k].linear) + v);
      give(k, Vec3(torque[0], torque[1], torque[2]));
    });
  }
}

JointQuaternion JointGroup::rotations(const Places& places, const std::int32_t* members) {
  const auto q = load_points<V>(places.q.data(), members);
  return {q.x, {{q.y, q.z, q.w}}};
}

JointSides JointGroup::sides(const JointFrames& frames, const Places& places,
                             const std::int32_t* members) {
  const auto x = load_points<V>(places.x.data(), members);
  return {frames, {{x.x, x.y, x.z}}, rotations(places, members)};
}

void JointGroup::find_values(const Pack& pack, const Places& places, bool coordinates, V* C) {
  joint_values(pack.type, sides(pack.in_a, places, pack.a), sides(pack.in_b, places, pack.b),
               pack.coordinate, coordinates, C);
}

void JointGroup::set_gradients() {
  for (Pack& pack : packs_) {
    const JointSides a = sides(pack.in_a, now_, pack.a), b = sides(pack.in_b, now_, pack.b);
    joint_gradients(pack.type, a, b, pack.G);
    joint_values(pack.type, a, b, pack.coordinate, pack.rows > pack.equations, pack.begin);
    for (V& sum : pack.mobility) sum = V{};
    const auto scale = [&](const std::int32_t* members, const JointVector& arm,
                           V(*scaled)[JointMatrix::kSize]) {
      const auto root = [&](int lane) { return &root_[usize(members[lane])]; };
      const auto p = load_rows<V>([&](int lane) { return &root(lane)->linear; });
      const auto q = load_rows<V>([&](int lane) { return &root(lane)->angular; });
      const V xx = q.w * p.x, yy = q.w * p.y, zz = q.w * p.z, mass = q.w * p.w;
      const V xy = q.w * q.x, xz = q.w * q.y, yz = q.w * q.z;
      for (int row = 0; row < pack.rows; ++row) {
        const bool turn = is_turn(pack.type, row);
        const JointVector& axis = pack.G.axis[row];
        const JointVector linear = (turn ? V{} : mass) * axis, m = turn ? axis : cross(arm, axis);
        V* const g = scaled[row];
        for (int i = 0; i < 3; ++i) g[i] = linear[i];
        g[3] = xx * m[0] + xy * m[1] + xz * m[2];
        g[4] = xy * m[0] + yy * m[1] + yz * m[2];
        g[5] = xz * m[0] + yz * m[1] + zz * m[2];
        for (int i = 0; i < JointMatrix::kSize; ++i) pack.mobility[row] += g[i] * g[i];
      }
    };
    scale(pack.a, pack.G.arm_a, pack.scaled_a);
    scale(pack.b, pack.G.arm_b, pack.scaled_b);
  }
  factored_ = false;
}

void JointGroup::factor() {
  matrix_.clear();
  for (const Pack& pack : packs_) {
    for (int lane = 0; lane < pack.count; ++lane) {
      const Link& link = links_[usize(pack.link[lane])];
      for (int row = 0; row < link.rows; ++row) {
        JointMatrix::Piece a, b;
        if (!link.active(row)) {
          a.fill(0);
          matrix_.set(pack.link[lane], row, a, a, 1);
          continue;
        }
        double E = regularisation_ * pack.mobility[row][lane];
        if (row >= link.equations) {
          const std::size_t k = usize(row - link.equations);
          E += link.law[k].softness(link.mode[k]);
        }
        for (int i = 0; i < JointMatrix::kSize; ++i) {
          a[usize(i)] = pack.scaled_a[row][i][lane];
          b[usize(i)] = -pack.scaled_b[row][i][lane];
        }
        matrix_.set(pack.link[lane], row, a, b, E);
      }
    }
  }
  matrix_.factor();
  factored_ = true;
}

// Forces f at arms r turn a body back into their direction, by K = r . f: a link of a rope that
// holds a heavy load swings about its centre at w = sqrt(K / I). That is unstable from h w = 2 on,
// so impulses turn it as if its moments were at least those of a smaller h w; no others change, nor
// how it turns freely (Andrews, Teichmann and Kovecses 2017, Comput. Animat. Virtual Worlds 28).
void JointGroup::find_inertia(BodyRows& rows) {
  for (BodyRow& arm : sums_) arm = {};  // K for the three axes; sum of K r, and of K
  for (const Pack& pack : packs_) {
    if (pack.type == JointType::kSlider || pack.type == JointType::kDistance) continue;
    const auto add_side = [&](const JointFrames& frames, const std::int32_t* members, double sign) {
      const JointVector force{{pack.last[0], pack.last[1], pack.last[2]}};
      const JointVector f = rotations(now_, members).conjugate().rotated(force);
      const JointVector& r = frames.anchor;
      const V K = sign / settings_.h * dot(r, f);
      if (!any(K > 0.0)) return;
      const V square = dot(r, r);
      for (int lane = 0; lane < pack.count; ++lane) {
        if (!(K[lane] > 0)) continue;
        BodyRow& arm = sums_[usize(members[lane])];
        const Vec3 at(r[0][lane], r[1][lane], r[2][lane]);
        add(arm.linear, K[lane] * (Vec3::Ones() - at.cwiseAbs2() / square[lane]));
        add(arm.angular, K[lane] * at);
        arm.angular.w += K[lane];
      }
    };
    add_side(pack.in_a, pack.a, 1);
    add_side(pack.in_b, pack.b, -1);
  }
  const double most = smooth_ ? kFreeSwing : kSwing;
  whirls_ = false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    const BodyRow& arm = sums_[k];
    Vec3 inertia = m.inertia;
    if (m.moves && arm.angular.w > 0) {
      // What hangs at one end swings about it.
      const Vec3 r = 1 / (m.scale * arm.angular.w) * from_row(arm.angular);
      const Vec3 about_end = Vec3::Constant(r.squaredNorm()) - r.cwiseAbs2();
      const Vec3 least =
          settings_.h * settings_.h / (most * most) * from_row(arm.linear) - about_end;
      inertia = inertia.cwiseMax(least);
      whirls_ |= inertia != m.inertia;
    }
    see_inertia(k, inertia, rows);
  }
}

void JointGroup::mark_bodies(std::span<std::uint8_t> bodies) const {
  for (const Member& m : members_)
    if (m.moves) bodies[usize(m.body)] = 1;
}

// Takes energy within a step: larger moments have the momentum that was.
void JointGroup::see_inertia(std::size_t member, const Vec3& inertia, BodyRows& rows) {
  Member& m = members_[member];
  if (m.seen_inertia == inertia) return;
  if (begins_) {
    m.seen_inertia = inertia;
    refresh(member, rows);
    return;
  }
  const Quaternion q = rotation(member);
  Eigen::Map<Vec3> L(&L_[3 * member]);
  const Vec3 ratio = m.seen_inertia.cwiseQuotient(inertia);
  Vec3 kept = ratio.cwiseMin(1);
  if (!smooth_) kept = kept.cwiseMin(ratio.cwiseInverse());
  L = q * (q.conjugate() * L).cwiseProduct(kept);
  m.seen_inertia = inertia;
  refresh_within(member, rows);
}

void JointGroup::begin_substep(BodyRows& rows) {
  tried_ = false;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    const BodyRow &x = rows.displacement[usize(m.row)], &free = rows.free[usize(m.row)];
    const BodyRow& a = rows.acceleration[usize(m.row)];
    // The half kick back that begins a step is none of what was before it.
    const double kicked = settings_.h - weight_ * settings_.h;
    before_[k] = {};
    assign(before_[k].linear,
           m.scale * (from_row(free.linear) - weight_ * settings_.h * from_row(a.linear)));
    assign(before_[k].angular, m.W * (momentum(k) + kicked * (m.unroot * from_row(a.angular))));
    m.start = from_row(x.linear);
    m.start_turn = from_row(x.angular);
    if (!m.moves) continue;
    BodyRow& v = rows.velocity[usize(m.row)];
    add(v.linear, -from_row(given_[k].linear));
    add(v.angular, -from_row(given_[k].angular));
    given_[k] = {};
  }
  read_momenta(rows);
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    assign(now_.x[k], m.origin + m.scale * m.start);
    if (!m.moves || m.start_turn == m.seen_turn) continue;  // else by an impact
    turn(k, m.root * (m.start_turn - m.seen_turn));
    m.seen_turn = m.start_turn;
    refresh_within(k, rows);
  }
  if (!begins_) find_inertia(rows);
  begins_ = false;
  set_gradients();
  for (Pack& pack : packs_) {
    set_laws(pack, Stage::kMotion);
    for (int row = 0; row < kJointRows; ++row) {
      pack.impulse[row] = V{};
      pack.last[row] = weight_ * pack.last[row];
    }
    store_pieces(pack, pack.last);
  }
  apply(rows);
}

void JointGroup::sum_impulses(Pack& pack) {
  const Wrench given = wrench(pack, pack.impulse);
  pack.force = pack.force + given.force;
  pack.torque = pack.torque + (given.torque_a - cross(pack.G.arm_a, given.force));
  const int own = coordinate_row(pack.type);
  if (own >= 0 && own < pack.rows) pack.effort += pack.impulse[own];
}

// The impulses that the next sub-step begins with. A force at the anchor turns with the bodies:
// across a long arm of a light body the part of it that stayed behind would whirl the body around.
// It turns with the one that it would whirl more.
void JointGroup::turn_impulses(Pack& pack) const {
  for (int row = 0; row < kJointRows; ++row) pack.last[row] = 1 / weight_ * pack.impulse[row];
  if (pack.type == JointType::kSlider || pack.type == JointType::kDistance) return;
  V weights{};
  JointVector turn{};
  const auto add_side = [&](const std::int32_t* members, const V(*scaled)[JointMatrix::kSize]) {
    V weight{};
    for (int row = 0; row < 3; ++row)
      for (int i = 3; i < 6; ++i) weight += scaled[row][i] * scaled[row][i];
    weights += weight;
    turn = turn + weight * rotation_vector(rotations(trial_, members) *
                                           rotations(now_, members).conjugate());
  };
  add_side(pack.a, pack.scaled_a);
  add_side(pack.b, pack.scaled_b);
  const auto turns = weights > 0.0;
  const JointVector mean = (1.0 / select(turns, weights, splat<V>(1))) * turn;
  const JointVector force = rotation_by(mean).rotated({{pack.last[0], pack.last[1], pack.last[2]}});
  for (int i = 0; i < 3; ++i) pack.last[i] = select(turns, force[i], pack.last[i]);
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
  for (Pack& pack : packs_) {
    sum_impulses(pack);
    turn_impulses(pack);
  }
  std::swap(now_, trial_);
  weight_ = 1;
}

void JointGroup::end_step(BodyRows& rows) {
  if (smooth_) {
    for (std::size_t k = 0; k < members_.size(); ++k) {
      const Member& m = members_[k];
      assign(before_[k].linear, m.scale * from_row(rows.velocity[usize(m.row)].linear));
      assign(before_[k].angular, m.W * momentum(k));
    }
    kick(0.5 * settings_.h, rows);
    weight_ = 0.5;
    set_gradients();
    for (Pack& pack : packs_) {
      set_laws(pack, Stage::kVelocity);
      for (V& l : pack.impulse) l = V{};
    }
    solve(Stage::kVelocity, rows, kTolerance);
    write_momenta(rows);
    for (Pack& pack : packs_) sum_impulses(pack);
  }
}

void JointGroup::store(Bodies& bodies, std::span<Joint> joints, double dt) const {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (!m.moves) continue;
    store_quaternion(rotation(k), &bodies.q[4 * usize(m.body)]);
    Vec3::Map(&bodies.L[3 * usize(m.body)]) = momentum(k);
  }
  for (const Pack& pack : packs_) {
    V C[kJointRows];
    find_values(pack, now_, true, C);
    for (int lane = 0; lane < pack.count; ++lane) {
      const Link& link = links_[usize(pack.link[lane])];
      Joint& joint = joints[usize(link.number)];
      joint.coordinate = pack.coordinate[lane];
      joint.effort = pack.effort[lane] / dt;
      for (int i = 0; i < 3; ++i) {
        joint.force[i] = pack.force[i][lane] / dt;
        joint.torque[i] = pack.torque[i][lane] / dt;
      }
      joint.length_error = joint.angle_error = 0;
      for (int row = 0; row < kJointRows; ++row) joint.impulse[usize(row)] = pack.last[row][lane];
      for (int row = 0; row < link.rows; ++row) {
        double error = C[row][lane];
        if (row >= link.equations) {
          const bool own = row == coordinate_row(joint.type);
          const double upper = own ? joint.upper : joint.cone;
          error = std::max({0., error - upper, own ? joint.lower - error : 0.});
        }
        double& sum = is_turn(joint.type, row) ? joint.angle_error : joint.length_error;
        sum = std::hypot(sum, error);
      }
    }
  }
}

}  // namespace substep::rigid
