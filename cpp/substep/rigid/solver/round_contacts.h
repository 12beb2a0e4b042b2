// Contacts of spheres and capsules found anew in each sub-step, in the lanes of their packet.
//
// A sphere or a capsule is all within a radius of a segment c + s d, |s| <= 1, with d = 0 of a
// sphere. It touches a plane with both ends, and another one where the segments are closest
// (Ericson 2005, "Real-time collision detection", section 5.1.9). This is what the narrow phase
// does contact by contact, with bodies displaced as body_rows.h has it; points of a contact are the
// same two ends throughout a step, of which those act that `used` says.
#pragma once

#include <cstdint>

#include "substep/core/quaternion_lanes.h"
#include "substep/rigid/motion/bodies.h"
#include "substep/rigid/solver/contact_packet.h"

namespace substep::rigid {

inline constexpr double kReached = 1e-5;  // the height over the nearest point that is none [m]

// Where it is at the start of a step. Of a plane: a point of it and its normal.
struct RoundShape {
  Vec3 centre, along;
  double radius = 0;
  bool plane = false;
};
struct RoundPair {
  RoundShape a, b;  // one of them no plane
  double acts;      // impulses act at this part of the way from the surface of a to that of b
};

class RoundContacts {
 public:
  using V = ContactPacket::V;
  using V3 = ContactPacket::V3;
  using Mask = decltype(V{} < V{});

  // Impulses go on while the plane of contact leaves more than this of the square of its tangent.
  static constexpr double kSameTangent = 0.25;

  RoundContacts() = default;  // holds nothing before clear()
  void clear();
  // The contact of this lane, whose bodies turn by their displacements.
  void add(int lane, const RoundPair& pair, const ContactConstraint& contact, const Bodies& bodies);
  bool has(int lane) const { return has_[lane] != 0; }

  // Where they touch now, for the packet to be prepared. Those of capsules that are nearly
  // parallel, or of axes that meet, are left out, and no longer here: left() for the narrow phase.
  void find(const BodyRows& rows, double h, ContactPacket& packet);
  bool left(int lane) const { return left_[lane] != 0; }
  // What was found last, with what has become of it since.
  void report(int lane, const ContactPacket& packet, ContactConstraint& contact) const;
  // Before report(): the points in the frames of the bodies, and the separations of now.
  void finish(const BodyRows& rows, const ContactPacket& packet);

 private:
  struct Side {
    V3 position;       // of the body
    V3 centre, along;  // from there
    V radius;
    Mask plane;
    QuaternionLanes<V> rotation;  // of the body
  };
  struct Placed {
    V3 position;
    QuaternionLanes<V> turned;
    V3 centre, along, velocity, spin;
  };
  struct Touch {
    V3 normal, middle[2];  // of the surfaces at each point
    V separation[2];
    Mask two, fails;  // whether there is a second point; whether it is none of these
  };
  struct Found {
    V3 middle[2];
    V separation[2];
    V3 position_a, position_b;
    QuaternionLanes<V> turned_a, turned_b;
  };

  static Placed place(const Side& side, bool moves, const std::int32_t* index,
                      const BodyRows& rows);
  void touch_plane(const Placed& a, const Placed& b, Touch& touch) const;
  void touch_segments(const Placed& a, const Placed& b, Touch& touch) const;

  Side a_, b_;
  V acts_, margin_;
  Mask has_, left_, found_;
  Found now_, last_;  // last_: of those that are left
  V3 in_a_[2], in_b_[2];
  V separation_[4];
};

}  // namespace substep::rigid
