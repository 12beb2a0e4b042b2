// Which impulses of the last step held what is no longer there.
//
// A step begins with the impulses of the last sub-step, which is right for a load that stays. Where
// one has ended (a body that lay on others is taken away, a force ends, gravity changes), what held
// it would throw the bodies in between: sweeps take it back contact by contact, and before they are
// through, a stack has left the ground. So this finds bodies whose velocity the beginning of the
// step would change by more than kMuch h |g|. With that change d and what it has of contacts that
// push along it, e, such a body does without the part
//   f = d.M e / e.M e,  limited to 0 <= f <= 1,
// of these, which leaves it the least change. Its neighbours lose what pressed on them, and may be
// thrown in turn: the end of a load passes from body to body, down to the ground. ImpactStart then
// takes as much of all that as lowers the energy, so this need only be a good guess.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "substep/core/incidence.h"
#include "substep/rigid/solver/contact_packet.h"

namespace substep::rigid {

class LoadEnds {
 public:
  // Of the impulses of the contact in this lane of a packet, what has no more to hold.
  struct Part {
    std::int64_t packet;
    int lane;
    double part;
  };
  // Whether the contact presses, but in no impact.
  using Bears = std::function<bool(std::int64_t packet, int lane)>;

  // Of rows that have been accelerated, by h. jointed: not 0 for rows with joints, which also push.
  std::span<const Part> find(const BodyRows& rows, std::span<const ContactPacket> packets,
                             const Bears& bears, std::span<const std::uint8_t> jointed, double h,
                             double fast);

 private:
  static constexpr double kMuch = 4;
  static constexpr int kTimes = 16;  // that a body is looked at, at most

  struct Push {
    std::int32_t place;
    BodyRow impulse;  // all of it, as it changes the velocity
  };

  BodyRow change(const BodyRows& rows, std::size_t row, double h) const;
  void pass_on(std::int32_t row, double part, std::span<const ContactPacket> packets,
               std::span<const std::uint8_t> jointed);

  Incidence contacts_of_;             // of each row: lanes, counted through the packets
  std::vector<double> left_;          // of the impulses in each lane
  std::vector<BodyRow> lost_;         // of each row, by what is not left
  std::vector<std::uint8_t> times_;   // of each row
  std::vector<std::int32_t> thrown_;  // rows
  std::vector<Push> pushes_;          // along the change
  std::vector<Part> parts_;
};

}  // namespace substep::rigid
