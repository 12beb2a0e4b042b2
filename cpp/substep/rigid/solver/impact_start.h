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
// descent on that of the dual problem), so what starts a sub-step can never add to it. v.M e is the
// power of d: with that on kinematic bodies, so that s is the same in all frames, and without that
// of friction that brakes, which acts only while the pressure does.
//
// A contact has been hit where its pressure exceeds what it carried before, its load, by more than
// kJump h |n.g| m, with the smaller mass m of its two bodies: by a few times what gravity gives
// along its normal in a sub-step. Then the load grows by h |n.g| m and by kMore of itself, and what
// is above it is of an impact; elsewhere the load is all of the pressure, so contacts that stand
// start as they would without all this.
//
// Of loads that have ended (load_ends.h), s of what they leave is withdrawn in the same way.
//
// Joints pass on what an impact gives one of their bodies, and what the others weigh. With the mass
// M of all that they connect, a jump is at least h |g| M there, the load grows by h |g| (m M)^1/2,
// whatever the normal is, as motors and springs press in any direction, and e is all that contacts
// and joints changed in the last sub-step. A contact between bodies that joints connect is never
// hit: it and the joints share what comes between them.
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
  // Of a contact of these rows, before begin(), where gravity gives the speed `fast` along n.
  double jump(std::int32_t a, std::int32_t b, double fast) const {
    if (joined_.empty()) return kJump * growth(a, b, fast);
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
  // Without joints e is what the contacts changed, also of bodies that have some.
  void begin(bool with_joints);
  void add(const ContactPacket& packet, const V& load, const BodyRows& rows);
  void withdraw(BodyRows& rows);
  // The same of a part of the impulses of one contact.
  void add(const ContactPacket& packet, int lane, double part, const BodyRows& rows);
  double left(const ContactPacket& packet, int lane, double part) const {
    return 1 - part * withdrawn(row_of(packet, lane));
  }
  // Whether the contact is part of an impact that goes on: s would be below 0.
  bool goes_on(const ContactPacket& packet, const V& load, int lane) const {
    const Row& all = all_of(row_of(packet, lane));
    return kSame * packet.pressure()[lane] > load[lane] && all.along < -kGoesOn * all.square;
  }
  V left(const ContactPacket& packet, const V& load) const;

 private:
  static constexpr double kSame = 1 - 1e-9;
  static constexpr double kJump = 4, kMore = 0.1, kGoesOn = 0.01;

  struct Row {
    double jump, growth;  // masses; infinite where impulses move nothing
    bool jointed = false, hit = false;
    double power = 0;  // of d that is not in v.M e of rows: kinematic bodies, friction
    // Of all with this label: v.M e, e.M e and s.
    double along = 0, square = 0, withdrawn = 0;
  };
  // One that the contact moves.
  static std::size_t row_of(const ContactPacket& packet, int lane) {
    return usize(packet.moves_a[lane] ? packet.a[lane] : packet.b[lane]);
  }
  void add_row(std::int32_t row);
  const Row& all_of(std::size_t row) const { return rows_[usize(label_[row])]; }
  double withdrawn(std::size_t row) const { return all_of(row).withdrawn; }

  std::vector<BodyPair> pairs_;        // rows that joints and hit contacts connect
  std::vector<std::int32_t> hit_;      // rows of joints and of hit contacts
  std::vector<BodyPair> joined_;       // those of joints
  std::vector<std::int32_t> jointed_;  // those of joints
  std::vector<std::int32_t> label_;
  std::vector<Row> rows_;
  bool with_joints_ = true;
  BodyRows::Rows excess_;  // e, 0 between sub-steps
};

}  // namespace substep::rigid
