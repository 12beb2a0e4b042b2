// What of the impulses of an impact starts the next sub-step.
//
// A sub-step begins with the impulses l of the last one, which is right for what contacts carry: it
// is the same again. Of an impact it is right only as far as the sweeps have not converged. Two of
// them stop the lowest box of a column, and the rest of the impact goes up through it sub-step by
// sub-step; but an impulse that has done its work would throw the column up when it acts again.
// With the part d of l that is of an impact, e = M^-1 J^T d and the velocities v that all of l
// gives, the kinetic energy along d is least for l - s d with
//   s = v.M e / e.M e,  limited to 0 <= s <= 1,
// over bodies that such contacts connect. From there sweeps lower the energy (they are coordinate
// descent on that of the dual problem), so what starts a sub-step can never add to it.
//
// A contact has been hit where its pressure exceeds what it carried before, its load, by more than
// kJump h |g| m, with the smaller mass m of its two bodies: by a few times what gravity gives in a
// sub-step. Then the load grows by h |g| m and by kMore of itself, and what is above it is of an
// impact; elsewhere the load is all of the pressure, so contacts that stand start as they would
// without all this.
//
// Joints pass on what an impact gives one of their bodies, and what the others weigh. With the mass
// M of all that they connect, a jump is at least h |g| M there, the load grows by h |g| (m M)^1/2,
// and e is all that contacts and joints changed in the last sub-step. A contact between bodies that
// joints connect is never hit: it and the joints share what comes between them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/motion/body_pair.h"
#include "substep/rigid/solver/contact_packet.h"
#include "substep/rigid/solver/joint.h"

namespace substep::rigid {

class ImpactStart {
 public:
  using V = ContactPacket::V;

  // Nothing of it outlives a step, so there is nothing to copy.
  ImpactStart() = default;
  ImpactStart(const ImpactStart&) {}
  ImpactStart& operator=(const ImpactStart&) { return *this; }

  void begin_step(std::span<const Joint> joints, const BodyRows& rows);
  // Of a contact of these rows, before begin(), where gravity gives the speed `fast` in a sub-step.
  double jump(std::int32_t a, std::int32_t b, double fast) const {
    if (joined_ == 0) return kJump * growth(a, b, fast);
    if (label_[usize(a)] == label_[usize(b)]) return std::numeric_limits<double>::infinity();
    return fast * std::min(rows_[usize(a)].jump, rows_[usize(b)].jump);
  }
  double growth(std::int32_t a, std::int32_t b, double fast) const {
    return fast * std::min(rows_[usize(a)].growth, rows_[usize(b)].growth);
  }
  // The load after a sub-step.
  static void grow(const ContactPacket& packet, const V& jump, const V& growth, V& load) {
    const V all = packet.pressure();
    const V grown = load + kMore * load + growth;
    load = (all <= load + jump) | (all < grown) ? all : grown;
  }
  // Whether any contact has more than its load, and than rounding makes of it.
  static bool is_hit(const ContactPacket& packet, const V& load) {
    return any(kSame * packet.pressure() > load);
  }

  // Contacts with more than their load, one packet after the other; then withdraw(), which takes s
  // of it from the velocities, and the parts that are left of the impulses of each packet.
  void begin();
  void add(const ContactPacket& packet, const V& load);
  void withdraw(BodyRows& rows);
  V left(const ContactPacket& packet, const V& load) const;

 private:
  static constexpr double kSame = 1 - 1e-9;
  static constexpr double kJump = 4, kMore = 0.1;

  double withdrawn(std::size_t row) const;  // s

  struct Row {
    double jump, growth;  // masses; infinite where impulses move nothing
    bool jointed = false, hit = false;
    double along = 0, square = 0;  // v.M e and e.M e, of all with this label
  };
  void add_row(std::int32_t row);

  std::vector<BodyPair> pairs_;           // rows that joints and hit contacts connect
  std::vector<std::int32_t> hit_;         // rows of joints and of hit contacts
  std::size_t joined_ = 0, jointed_ = 0;  // how many of those are of joints
  std::vector<std::int32_t> label_;
  std::vector<Row> rows_;
  BodyRows::Rows excess_;  // e, 0 between sub-steps
};

}  // namespace substep::rigid
