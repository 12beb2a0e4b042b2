// JointGroup: what is left of C is taken back by displacements.
#include <algorithm>
#include <cmath>

#include "substep/core/point_scatter.h"
#include "substep/core/usize.h"
#include "substep/rigid/motion/row_vectors.h"
#include "substep/rigid/solver/joint_group.h"

namespace substep::rigid {
namespace {

using Mode = JointLaw::Mode;

// C that is not worth taking back, and what a second time is for: after contacts have pushed far.
constexpr double kEnoughPosition = 1e-10, kFarPosition = 1e-6;
constexpr double kPassed = 1e-7;  // a limit, which is to be kept again [m], [rad]
constexpr int kRounds = 3;

}  // namespace

void JointGroup::solve_positions(BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    const BodyRow& x = rows.displacement[usize(m.row)];
    assign(now_.x[k], m.origin + m.scale * from_row(x.linear));
    const Vec3 by = from_row(x.angular);
    if (m.moves && by != m.seen_turn) turn(k, m.root * (by - m.seen_turn));  // by contacts
  }
  for (int round = 0; round < kRounds; ++round)
    if (!(correct_positions(rows) > kFarPosition)) break;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    m.seen_turn = from_row(rows.displacement[usize(m.row)].angular);
    refresh(k, rows);
  }
}

// Returns the largest of C before.
double JointGroup::correct_positions(BodyRows& rows) {
  double worst = 0;
  for (Pack& pack : packs_) {
    V C[kJointRows];
    find_values(pack, now_, true, C);
    const int own = coordinate_row(pack.type);
    if (own >= 0) pack.coordinate = C[own];
    V errors[kJointRows] = {};
    for (int lane = 0; lane < kLanes; ++lane) {
      Link& link = links_[usize(pack.link[lane])];
      for (int row = 0; row < link.rows; ++row) {
        double c = C[row][lane];
        if (row >= link.equations) {
          Mode& mode = link.mode[usize(row - link.equations)];
          const double lower = row == own ? link.joint.lower : -Joint::kInfinite;
          const double upper = row == own ? link.joint.upper : link.joint.cone;
          c -= std::clamp(c, lower, upper);
          if (mode != Mode::kLower && mode != Mode::kUpper) {
            if (!(std::abs(c) > kPassed)) continue;
            mode = c < 0 ? Mode::kLower : Mode::kUpper;
            factored_ = false;
          }
        }
        errors[row][lane] = std::clamp(c, -settings_.push, settings_.push);
        worst = std::max(worst, std::abs(c));
      }
    }
    store_pieces(pack, errors);
  }
  if (!(worst > kEnoughPosition)) return worst;
  if (!factored_) factor();
  matrix_.solve(pieces_);
  for (BodyRow& sum : sums_) sum = {};
  for (const Pack& pack : packs_) {
    V l[kJointRows];
    load_pieces(pack, l);
    each_side(pack, wrench(pack, l), [&](std::size_t k, const auto& force, const auto& torque) {
      store_quad(sums_[k].linear, load_quad(sums_[k].linear) + force);
      store_quad(sums_[k].angular, load_quad(sums_[k].angular) + torque);
    });
  }
  double largest = settings_.push;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (!m.moves) continue;
    const Vec3 shift = m.scale * from_row(sums_[k].linear);
    const Vec3 by = m.response * from_row(sums_[k].angular);
    assign(sums_[k].linear, shift), assign(sums_[k].angular, by);
    largest = std::max({largest, m.scale * shift.norm(), by.norm()});
  }
  const double part = settings_.push / largest;
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Member& m = members_[k];
    if (!m.moves) continue;
    BodyRow& x = rows.displacement[usize(m.row)];
    const Vec3 angle = part * from_row(sums_[k].angular);
    add(x.linear, part * from_row(sums_[k].linear));
    add(x.angular, m.unroot * angle);
    assign(now_.x[k], m.origin + m.scale * from_row(x.linear));
    turn(k, angle);
  }
  return worst;
}

}  // namespace substep::rigid
