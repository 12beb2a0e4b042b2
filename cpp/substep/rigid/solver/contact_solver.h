// The step of bodies in contact: sub-steps, each with a sweep or two of exact blocks.
//
// A step dt is n sub-steps h = dt / n (Macklin et al. 2019, "Small steps in physics simulation",
// SCA, section 3: n sub-steps of one iteration converge better than one step of n), and a sub-step
//   1. impacts with restitution, each at its time                         impacts.h
//   2. v += h (g + F / m) + what the contacts gave in the last sub-step   (warm start), of impacts
//      only some, and less where loads have ended                  impact_start.h, load_ends.h
//   3. m sweeps over the joints, then over the contacts: friction and normal impulses until
//        u_n + max(C, 0) / h >= 0,                                        contact_packet.h
//      without any term that pushes apart what overlaps; more sweeps over those light bodies
//      that a heavy load, at their joints or on them, presses on something
//   4. x += h v
// and what overlaps by more than the slop is moved apart by the part beta of it, without velocity
// (pseudo-velocities from none, in every sub-step), as the first sweep of the next sub-step comes
// to the contact; what is much heavier than what bears it as if that were fixed (Guendelman,
// Bridson and Fedkiw 2003, "Nonconvex rigid bodies with stacking", ACM Trans. Graph. 22,
// shock propagation), else a load sinks into a light plate faster than it is lifted. That is apart
// from 3 because impulses that push positions, kept for the warm start, are an integral action on
// what sweeps have not converged: of the slowest modes,
//   l' = -c (u + b x) - k l,  m u' = l,  so  s^3 + (k / m) s^2 + (c / m) (s + b) = 0,
// stable (Routh) only if k > m b. A soft constraint (Catto 2024, "Solver2D", box2d.org, "Soft
// Step") buys that with the leak k, and sinks under load by what the leak loses: 106 mm in a stack
// of 20. Displacements that are not kept have no such mode, so the contact needs no leak and
// carries any load without sinking; docs/rigid_contact.md has the table.
//
// What sweeps have not converged of the velocities swings: a mode with the part c of its error
// taken by a sub-step has e = l + f and u (its impulse less the load, its velocity) go by
//   u' = (1 - c) (u + e / m),  e' = e - c m (u + e / m),
// of determinant 1 - c: it loses c / 2 a sub-step, so a stack of 20 sways for a minute. As bodies
// that stand have no velocity in the end, they lose what little they have at the rate
// `settling`: those that rest with a face, by friction well within the cone, on a body that stands,
// at first on a static one, and are slower than half of what gravity gives in a sub-step, which
// friction would stop at once.
//
// World inertias and the points of contact stay those of the start of the step, but where round
// shapes roll: their contacts, and the inertia of their bodies, are found anew for each sub-step.
// There J v = 0 of its begin would make a body that rolls in a curve leave it along the tangent,
// and take (h w)^2 of its energy each time; so that it ends on the curve, impulses act along J of
// the begin until what they constrain is fulfilled on the average over the sub-step,
//   J(x) v + (J(x + h v) - J(x)) v / 2 = 0,
// of second order, as SHAKE is for joints (Ryckaert, Ciccotti and Berendsen 1977), also where the
// constraint is one of velocities: a disk that rolls.
//
// Packets of one colour run on several threads; the order of the sweep is fixed, so bits do not
// depend on them.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "substep/core/radix_sort.h"
#include "substep/rigid/solver/contact_options.h"
#include "substep/rigid/solver/contact_packet.h"
#include "substep/rigid/solver/graph_colouring.h"
#include "substep/rigid/solver/impact_start.h"
#include "substep/rigid/solver/impacts.h"
#include "substep/rigid/solver/joints.h"
#include "substep/rigid/solver/load_ends.h"
#include "substep/rigid/solver/round_contacts.h"

namespace substep::rigid {

class ContactSolver {
 public:
  // Puts a contact where its bodies touch at these poses, without impulses. Returns whether they
  // do; else it stays.
  using Touch = std::function<bool(const Pose& a, const Pose& b, ContactConstraint& contact)>;

  // Of a contact of round shapes only, with planes or each other: where those are at the start of
  // the step.
  using Round = std::function<std::optional<RoundPair>(const ContactConstraint& contact)>;

  // One step of dt for all bodies: forces, contacts, joints, free motion. The impulses of the
  // contacts are those of the last sub-step before, and are so after. Contacts must have been
  // looked for as far as bodies approach within dt. asleep: not 0 where a body is, or empty; those
  // are as static ones, and contacts between two that do not move stay as they are, at no cost.
  // Returns the first body whose motion is not finite at the end, or -1: then bodies, contacts and
  // joints are still what they were before.
  std::int64_t step(Bodies& bodies, const Vec3& gravity, double dt,
                    std::span<ContactConstraint> contacts, const ContactOptions& options,
                    std::span<const std::uint8_t> asleep = {}, std::span<Joint> joints = {},
                    int threads = 0, const Touch& touch = {}, const Round& round = {});

  std::int64_t impacts() const { return impacts_.happened(); }  // of the last step

 private:
  // Impulses of all sub-steps so far, and the load (impact_start.h).
  struct Given {
    ContactPacket::V normal[4], friction[2], load, jump, growth;
    void add(const ContactPacket& packet);
    void report(int lane, ContactConstraint& contact) const;
  };

  void order(const Vec3& gravity, std::span<const ContactConstraint> contacts, int threads);
  void ask_for_contact(std::size_t place, std::span<const ContactConstraint> contacts) const;
  void mark_standing(std::span<const ContactConstraint> contacts);
  void find_bearers(std::span<const ContactConstraint> contacts, const Vec3& gravity);
  void mark_borne(std::span<const ContactConstraint> contacts, const Vec3& gravity);
  void note_bearers(const Vec3& gravity, ContactPacket& packet) const;
  void pack(std::span<const ContactConstraint> contacts, const Vec3& fall, int threads);
  bool find_strained(std::span<const ContactConstraint> contacts, std::int64_t bodies);
  void bounce(double h, double slop);
  void start_impacts();
  void end_loads(double h, double fast);
  void mark_jointed(std::span<const Joint> joints);
  void find_rolling(std::span<ContactConstraint> contacts, double dt, double h, double slop);
  void find_round(std::span<const ContactConstraint> contacts, const Bodies& bodies,
                  const Round& round);
  void find_slipping(std::span<ContactConstraint> contacts, double fast);
  void note_slips(std::int64_t packet, std::span<ContactConstraint> contacts, double fast);
  bool is_rolling(std::int64_t packet, int lane) const;
  RoundContacts* round_of(std::int64_t packet);
  void note_separations(std::int64_t packet, std::span<ContactConstraint> contacts);
  void renew(std::int64_t packet, std::span<ContactConstraint> contacts, const Bodies& bodies,
             double h);
  bool find_anew(const Pose& a, const Pose& b, double h, ContactConstraint& contact) const;
  void drop_distant_points(ContactConstraint& contact, double h) const;
  void set_bias(std::int64_t packet, int lane, const ContactConstraint& contact,
                const Bodies& bodies, const Pose& now_a, const Pose& now_b, double h);

  BodyRows rows_;
  GraphColouring colouring_;
  Sweep sweep_;
  Impacts impacts_;
  ImpactStart impact_start_;
  LoadEnds load_ends_;
  JointSolver joints_;
  std::vector<KeyedIndex<std::uint32_t>> depth_;  // along gravity, contact
  RadixSort<std::uint32_t> sort_;
  std::vector<BodyPair> pairs_;
  std::vector<std::uint8_t> colours_;
  std::vector<std::int32_t> place_;   // lane of each contact in packets_, counted through; or -1
  std::vector<std::uint8_t> uneven_;  // of each packet: one body is much heavier
  std::vector<std::uint8_t> borne_;   // of each row
  AlignedBuffer<ContactPacket> packets_;
  AlignedBuffer<Given> given_;     // by each packet
  std::vector<std::uint8_t> hit_;  // of each packet: a contact has more than its load
  Touch touch_;
  std::vector<std::uint8_t> rolling_;          // of each contact: found anew in each sub-step
  std::vector<std::int32_t> turning_;          // rows
  std::vector<std::uint8_t> jointed_;          // of each row
  std::vector<std::uint8_t> bounces_;          // of each contact
  std::vector<std::int32_t> touched_;          // of each row, how many others it touches
  std::vector<std::int64_t> rolling_packets_;  // that hold such contacts
  std::vector<std::uint8_t> renewed_;          // of each packet: it is one of those
  std::vector<std::int32_t> round_;            // of each packet: its place in rounds_, or -1
  AlignedBuffer<RoundContacts> rounds_;
  std::vector<std::int64_t> slip_packets_;  // that hold contacts with two coefficients
  // Of each body: forces at its joints swing bodies, or it bears what is much heavier.
  std::vector<std::uint8_t> straining_;
  std::vector<std::uint8_t> strained_;  // of each packet: one of its bodies is such
};

}  // namespace substep::rigid
