// JointGroup: impulses, by Newton's method.
#include <algorithm>
#include <cmath>

#include "substep/core/point_lanes.h"
#include "substep/core/usize.h"
#include "substep/rigid/motion/row_vectors.h"
#include "substep/rigid/solver/joint_group.h"

namespace substep::rigid {
namespace {

using Mode = JointLaw::Mode;

constexpr int kIterations = 30, kPivots = 100;
constexpr double kMostTurn = 0.5;       // by a spring that yields, in a sub-step [rad]
constexpr double kWhirls = 1;           // in a sub-step, which no joint turns a body by [rad]
constexpr double kLittle = 1e-12;       // by which a law may be missed [rad], [m]
constexpr double kEnoughMotion = 1e-6;  // of C [m], [rad], where it does not get better

// What drives a row.
Joint::Motor motor_of(const Joint& joint, int row) {
  if (joint.type != JointType::kElastic)
    return row == coordinate_row(joint.type) ? joint.motor : Joint::Motor{};
  const Joint::Spring& spring = joint.spring;
  const int i = row - coordinate_row(joint.type);
  return {.type = MotorType::kSpring,
          .target = spring.rest[i],
          .stiffness = i == 0 ? spring.twist_stiffness : spring.swing_stiffness,
          .damping = i == 0 ? spring.twist_damping : spring.swing_damping};
}

}  // namespace

// With velocities of the members.
void JointGroup::find_velocity_rates(Pack& pack, const AlignedBuffer<BodyRow>& velocities) {
  const auto at_anchor = [&](const std::int32_t* members, const JointVector& arm, JointVector& w) {
    const auto row = [&](int lane) { return &velocities[usize(members[lane])]; };
    const auto p = load_rows<V>([&](int lane) { return &row(lane)->linear; });
    const auto q = load_rows<V>([&](int lane) { return &row(lane)->angular; });
    w = {{q.x, q.y, q.z}};
    return JointVector{{p.x, p.y, p.z}} + cross(w, arm);
  };
  JointVector w_a, w_b;
  const JointVector v = at_anchor(pack.a, pack.G.arm_a, w_a) - at_anchor(pack.b, pack.G.arm_b, w_b);
  const JointVector w = w_a - w_b;
  for (int row = 0; row < pack.rows; ++row)
    pack.rate[row] = dot(pack.G.axis[row], is_turn(pack.type, row) ? w : v);
}

void JointGroup::set_laws(Pack& pack, Stage stage) {
  if (pack.rows == pack.equations) return;
  const JointLaw::Interval interval{settings_.h, weight_, smooth_, closes_};
  find_velocity_rates(pack, before_);
  for (int lane = 0; lane < pack.count; ++lane) {
    Link& link = links_[usize(pack.link[lane])];
    const Joint& joint = link.joint;
    for (int row = link.equations; row < link.rows; ++row) {
      const std::size_t k = usize(row - link.equations);
      const bool own = row == coordinate_row(joint.type);
      link.law[k] =
          JointLaw::make(motor_of(joint, row), own ? joint.lower : -Joint::kInfinite,
                         own ? joint.upper : joint.cone, interval, stage, link.mode[k],
                         pack.begin[row][lane], pack.rate[row][lane], 1 / pack.mobility[row][lane]);
    }
  }
}

// Where the velocities lead to.
void JointGroup::find_trial(const BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    const Point<double>& v = rows.velocity[usize(m.row)].linear;
    m.seen_velocity = from_row(v);
    store_quad(trial_.x[k], load_quad(now_.x[k]) + settings_.h * m.scale * load_quad(v));
    trial_.q[k] = now_.q[k];
  }
  rotate_rows(settings_.method, static_cast<std::int64_t>(members_.size()), &trial_.q.data()->x,
              L_.data(), inertia_.data(), settings_.h);
  tried_ = true;
}

// Of the trial; where there are laws, also what those of the velocities lack of them.
void JointGroup::find_motion_rates(const BodyRows& rows) {
  if (has_laws_) find_rates(rows);
  find_trial(rows);
  for (Pack& pack : packs_) {
    V C[kJointRows];
    find_values(pack, trial_, pack.rows > pack.equations, C);
    for (int row = 0; row < pack.rows; ++row) {
      const V rate =
          (closes_ && row < pack.equations ? C[row] : C[row] - pack.begin[row]) / settings_.h;
      pack.beyond[row] = rate - pack.rate[row];
      pack.rate[row] = rate;
    }
  }
}

// Of the velocities.
void JointGroup::find_rates(const BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    store_quad(sums_[k].linear, m.scale * load_quad(rows.velocity[usize(m.row)].linear));
    assign(sums_[k].angular, m.W * momentum(k));
  }
  for (Pack& pack : packs_) find_velocity_rates(pack, sums_);
}

// The pieces become the impulses' changes that the modes fix; fixed: whether there are any. one:
// only the first mode that is another changes. Returns how many are others.
int JointGroup::choose_modes(bool one, bool& fixed) {
  int others = 0;
  for (Pack& pack : packs_) {
    if (pack.rows == pack.equations) continue;
    for (int lane = 0; lane < pack.count; ++lane) {
      Link& link = links_[usize(pack.link[lane])];
      for (int row = link.equations; row < link.rows; ++row) {
        const std::size_t k = usize(row - link.equations);
        const JointLaw& law = link.law[k];
        const double l = pack.impulse[row][lane];
        const Mode mode = law.next(link.mode[k], pack.rate[row][lane], l, pack.mobility[row][lane],
                                   kLittle / settings_.h, one);
        if (mode != link.mode[k] && (others++ == 0 || !one)) {
          link.mode[k] = mode;
          factored_ = false;
        }
        if (!JointLaw::fixes_impulse(link.mode[k])) continue;
        const double change = law.fixed_impulse(link.mode[k]) - l;
        if (change == 0) continue;
        if (!fixed)
          for (JointMatrix::Piece& piece : pieces_) piece.fill(0);
        fixed = true;
        pieces_[usize(pack.link[lane])][usize(row)] = change;
      }
    }
  }
  return others;
}

// To the pieces. Returns the largest error of C at the end of the sub-step.
double JointGroup::find_residuals() {
  V worst{};
  for (const Pack& pack : packs_) {
    V u[kJointRows];
    for (int row = 0; row < kJointRows; ++row) {
      u[row] = V{};
      if (row >= pack.rows) continue;
      u[row] = pack.rate[row];
      for (int lane = 0; row >= pack.equations && lane < kLanes; ++lane) {
        const Link& link = links_[usize(pack.link[lane])];
        const std::size_t k = usize(row - pack.equations);
        u[row][lane] =
            row < link.rows && link.active(row)
                ? link.law[k].residual(link.mode[k], pack.rate[row][lane], pack.impulse[row][lane])
                : 0;
      }
      u[row] += regularisation_ * pack.mobility[row] * pack.impulse[row];
      const V size = select(u[row] < 0.0, V(-u[row]), u[row]);
      worst = select(size > worst, size, worst);
    }
    store_pieces(pack, u);
  }
  double largest = 0;
  for (int lane = 0; lane < kLanes; ++lane) largest = std::max(largest, worst[lane]);
  return settings_.h * largest;
}

// With the modes that the linear problem leads to, about the motion so far. Returns whether they
// are found.
bool JointGroup::solve_linear(Stage stage, BodyRows& rows, int others) {
  for (JointPivots pivots; pivots.count < kPivots;) {
    if (!factored_) factor();
    matrix_.solve(pieces_);
    apply(rows);
    if (!has_laws_) return true;
    if (others > 0) pivots.add(others);
    const auto predict = [&] {
      find_rates(rows);
      if (stage == Stage::kVelocity) return;
      for (Pack& pack : packs_)
        for (int row = 0; row < pack.rows; ++row) pack.rate[row] += pack.beyond[row];
    };
    predict();
    bool fixed = false;
    others = choose_modes(pivots.one(), fixed);
    if (others == 0) return true;
    if (fixed) {
      apply(rows);
      predict();
    }
    find_residuals();
  }
  return false;
}

// Newton's method; ends where rounding does. Returns whether it has found the solution.
bool JointGroup::solve(Stage stage, BodyRows& rows, double tolerance) {
  double last = Joint::kInfinite;
  const auto find = [&] {
    if (stage == Stage::kMotion) {
      find_motion_rates(rows);
    } else {
      find_rates(rows);
    }
  };
  for (int k = 0; k < kIterations; ++k) {
    bool fixed = false;
    find();
    const int others = choose_modes(false, fixed);
    if (fixed) {
      apply(rows);
      find();
    }
    const double worst = find_residuals();
    if (others == 0 &&
        (worst < tolerance || (k > 2 && worst > 0.5 * last && worst < kEnoughMotion)))
      return true;
    last = worst;
    if (!solve_linear(stage, rows, others)) return false;
  }
  return last < kEnoughMotion;
}

// The impulses of the sub-step.
void JointGroup::take_back(BodyRows& rows) {
  for (Pack& pack : packs_) {
    for (V& l : pack.impulse) l = -l;
    store_pieces(pack, pack.impulse);
  }
  apply(rows);
  for (Pack& pack : packs_)
    for (V& l : pack.impulse) l = V{};
}

// Where springs turn their joints faster than sub-steps can follow, they turn them as fast as those
// can. Returns whether there are any.
bool JointGroup::slow_springs(const BodyRows& rows) {
  if (!has_springs_) return false;
  bool any = false;
  find_rates(rows);
  for (Pack& pack : packs_) {
    for (int lane = 0; lane < pack.count; ++lane) {
      Link& link = links_[usize(pack.link[lane])];
      for (int row = link.equations; row < link.rows; ++row) {
        JointLaw& law = link.law[usize(row - link.equations)];
        const double u = pack.rate[row][lane];
        const double most = std::max(kMostTurn / settings_.h, std::abs(law.before));
        if (!(law.compliance > 0) || !is_turn(pack.type, row) || !(std::abs(u) > most)) continue;
        law.rate = std::copysign(most, u);
        law.compliance = 0;
        any = true;
      }
    }
  }
  return any;
}

// Whether the motion found is one that turns a body far, where its ends fit again.
bool JointGroup::whirled() const {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    if (!members_[k].moves) continue;
    const double spin = (members_[k].W * momentum(k)).norm();
    if (settings_.h * spin > kWhirls && spin > 2 * from_row(before_[k].angular).norm()) return true;
  }
  return false;
}

// Where no motion that fulfils the constraints is near (a chain that snaps taut), the velocities
// do, which takes energy and so is stable; at the last, with coordinates that stay.
void JointGroup::solve_motion(BodyRows& rows, double tolerance) {
  const auto solve_either = [&] {
    if (solve(Stage::kMotion, rows, tolerance) && !whirled()) return;
    take_back(rows);
    if (solve(Stage::kVelocity, rows, kTolerance)) return;
    take_back(rows);
    for (Link& link : links_)
      for (JointLaw& law : link.law) law.slowest = law.fastest = 0;
    solve(Stage::kVelocity, rows, kTolerance);
  };
  solve_either();
  if (!slow_springs(rows)) return;
  take_back(rows);
  solve_either();
}

// What contacts will still change need not be found to the end.
void JointGroup::solve_velocities(BodyRows& rows, bool first, bool last) {
  if (first) {
    begin_substep(rows);
  } else if (!read_momenta(rows) && tried_ && solved_) {
    return;
  }
  solved_ = smooth_ || last;
  solve_motion(rows, solved_ ? kTolerance : kEnoughMotion);
  write_momenta(rows);
}

}  // namespace substep::rigid
