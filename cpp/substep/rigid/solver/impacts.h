// Impacts with restitution, each at its own time within the sub-step.
//
// A point of a contact at separation C with normal velocity u and free acceleration g (along the
// normal, of gravity, forces and what else presses on the bodies) reaches the surface after
//   t = 2 C / (s - u),  at the velocity -s,  s = sqrt(u^2 - 2 g C),
// which is exact for bodies that fly on parabolas. Then the impulses l >= 0 of the manifold fulfil
//   0 <= l_k  _|_  u_k after + e u_k before >= 0
// (Newton's law as Moreau 1988, "Unilateral contact and dry friction in finite freedom dynamics",
// states it for several points at once: it cannot gain energy), and friction takes the slip, within
// the cone. The impulse changes velocities by dv from t on, so in the coordinates of the
// sub-step's begin: v += dv, x -= t dv. So heights follow e^2 whatever the sub-step.
//
// Impacts happen in the order of their times, and one makes others: a row of balls passes on the
// first one's velocity (sequential impacts; Smith, Kaufman, Vouga, Tamstorf and Grinspun 2012,
// "Reflections on simultaneous impact", ACM TOG 31, section 3). One whose flight afterwards would
// take less than about two sub-steps is none: it rests, and what follows is the solver's.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "substep/core/incidence.h"
#include "substep/core/usize.h"
#include "substep/rigid/motion/body_rows.h"
#include "substep/rigid/solver/contact_constraint.h"

namespace substep::rigid {

class Impacts {
 public:
  // Puts a contact that rolls where its shapes are after a time; false if they are apart there.
  using Find = std::function<bool(ContactConstraint& contact, double time)>;

  // Takes the contacts with restitution, and those that roll and meet fast: such ones by `find`.
  void begin_step(std::span<const ContactConstraint> contacts,
                  std::span<const std::uint8_t> rolling, double h, const BodyRows& rows,
                  const Find& find);
  // Contacts that roll are elsewhere now.
  void renew(std::span<const ContactConstraint> contacts, const BodyRows& rows);
  bool empty() const { return contacts_.empty(); }

  // All impacts of the next h. Afterwards flying() tells, for the k-th of contact(k), whether it
  // is no contact of this sub-step: it bounced, or comes near so fast that it will.
  void advance(BodyRows& rows, double h, double slop);
  std::int64_t count() const { return static_cast<std::int64_t>(contacts_.size()); }
  std::int32_t contact(std::int64_t k) const { return contacts_[usize(k)].index; }
  bool flying(std::int64_t k) const { return flying_[usize(k)] != 0; }
  std::int64_t happened() const { return happened_; }  // in this step
  // Adds the impulses of this step to the totals of the contacts.
  void report(std::span<ContactConstraint> contacts) const;

 private:
  struct Gradient {
    Vec3 angular_a, angular_b;
  };
  // A contact in the coordinates of BodyRows.
  struct Row {
    std::int32_t index, a, b;  // a, b: rows
    int count;
    bool moves_a, moves_b, rolls;
    ContactConstraint contact;  // if it rolls
    double scale_a, scale_b, restitution, friction;
    Vec3 normal, tangent[2];
    double separation[4];
    Gradient points[4], slide[2];
    double block[4][4];
    double given[4], friction_given[2];  // in this step
  };
  struct Event {
    double time;
    std::int32_t row;
    bool operator>(const Event& other) const {
      return time != other.time ? time > other.time : row > other.row;
    }
  };
  enum class Fate { kResting, kFlying, kImpact };

  static void set(const ContactConstraint& contact, const BodyRows& rows, Row& row);
  bool meet(Row& row, const BodyRows& rows, double h, double& time) const;
  double along(const Row& row, const Vec3& direction, const Gradient& gradient,
               const BodyRows::Rows& rows) const;
  double acceleration(const Row& row, const BodyRows& rows, double h) const;
  Fate fate(const Row& row, const BodyRows& rows, double h, double& time) const;
  bool rests(const Row& row, const BodyRows& rows, double h, double slop) const;
  void collide(Row& row, BodyRows& rows, double h, double time) const;

  std::vector<Row> contacts_;
  Find find_;
  Incidence of_body_;  // contacts
  std::vector<std::uint8_t> flying_;
  std::vector<Event> queue_;
  std::int64_t happened_ = 0;
};

}  // namespace substep::rigid
