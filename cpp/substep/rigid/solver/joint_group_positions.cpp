// JointGroup: what is left of C is taken back by displacements.
#include <algorithm>
#include <cmath>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/motion/row_vectors.h"
#include "substep/rigid/solver/joint_group.h"

namespace substep::rigid {
namespace {

using Mode = JointLaw::Mode;

// C that is not worth taking back, and what a second time is for: after contacts have pushed far.
constexpr double kEnoughPosition = 1e-10, kFarPosition = 1e-6;
constexpr int kRounds = 3;

}  // namespace

void JointGroup::solve_positions(BodyRows& rows) {
  for (Member& m : members_) {
    const BodyRow& x = rows.displacement[usize(m.row)];
    m.now.x = m.origin + m.scale * from_row(x.linear);
    if (!m.moves) continue;
    const Vec3 turn = from_row(x.angular);
    if (turn != m.seen_turn) {  // by contacts
      m.now.q = (rotation_by(m.root * (turn - m.seen_turn)) * m.now.q).normalized();
    }
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
  for (std::size_t j = 0; j < links_.size(); ++j) {
    Link& link = links_[j];
    const auto C = values(link, false);
    const int own = coordinate_row(link.joint.type);
    if (own >= 0) link.joint.coordinate = C[usize(own)];
    pieces_[j].fill(0);
    for (int row = 0; row < link.rows; ++row) {
      double c = C[usize(row)];
      if (row >= link.equations) {
        const Mode mode = link.mode[usize(row - link.equations)];
        if (mode != Mode::kLower && mode != Mode::kUpper) continue;
        const double upper = row == own ? link.joint.upper : link.joint.cone;
        c -= mode == Mode::kLower ? link.joint.lower : upper;
      }
      pieces_[j][usize(row)] = std::clamp(c, -settings_.push, settings_.push);
      worst = std::max(worst, std::abs(c));
    }
  }
  if (worst > kEnoughPosition) {
    if (!factored_) factor();
    matrix_.solve(pieces_);
    std::vector<Vec3> shift(members_.size(), Vec3::Zero()), turn = shift;
    for (std::size_t j = 0; j < links_.size(); ++j) {
      const Link& link = links_[j];
      for (int row = 0; row < link.rows; ++row) {
        if (!link.active(row)) continue;
        const double l = pieces_[j][usize(row)];
        shift[usize(link.a)] += l * link.G.linear[row];
        turn[usize(link.a)] += l * link.G.angular_a[row];
        shift[usize(link.b)] -= l * link.G.linear[row];
        turn[usize(link.b)] -= l * link.G.angular_b[row];
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
      BodyRow& x = rows.displacement[usize(m.row)];
      const Vec3 angle = part * turn[k];
      add(x.linear, part * shift[k]);
      add(x.angular, m.unroot * angle);
      m.now.x = m.origin + m.scale * from_row(x.linear);
      m.now.q = (rotation_by(angle) * m.now.q).normalized();
    }
  }
  return worst;
}

}  // namespace substep::rigid
