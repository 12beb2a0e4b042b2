// Bodies that joints connect to a tree, in the coordinates that the joints leave free.
//
// A part is a body with the joint that holds it to its parent: a hinge turns by an angle, a ball by
// a rotation, a fixed joint not at all; the first part may hang from nothing and moves freely, or
// from the world. Its anchor O is where its joint is (of a free part: its centre of mass), d the
// vector to O from the anchor of its parent, c that from O to the centre of mass.
//
// The motion over a time h is that of the discrete Lagrangian
//   sum of m |x1 - x0|^2 / (2 h) + f . I f / (2 h),   f = log(R0^T R1),
// of all bodies: its momenta are P = m (x1 - x0) / h and, with J the left rates of the logarithm,
// L = R0 J^-T I f / h (Marsden and West 2001, "Discrete mechanics and variational integrators",
// Acta Numerica 10; Bou-Rabee and Marsden 2009, "Hamilton-Pontryagin integrators on Lie groups",
// Found. Comput. Math. 9, for the exponential). The coordinates are such that P and L differ from
// given ones by what joints can give, that is, by nothing along the free motions (the discrete
// Euler-Lagrange equations; Lee, Liu, Park and Srinivasa 2018, "A linear-time variational
// integrator for multibody systems", WAFR). They are found by Newton's method with the matrix of
// the begin, which is that of the articulated-body algorithm (Featherstone 2008, "Rigid Body
// Dynamics Algorithms", ch. 7), about each part's anchor and in the axes of the world:
//   [ torque about O ]   [ J    H ] [ angular acceleration ]
//   [ force          ] = [ H^T  M ] [ acceleration of O    ].
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/solver/quad_vectors.h"

namespace substep::rigid {

class ArticulatedTree {
 public:
  enum class Kind : std::uint8_t { kFree, kHinge, kBall, kFixed };

  struct Part {
    Kind kind = Kind::kFree;
    std::int32_t parent = -1;             // comes before it; -1: the world, or nothing
    Quad3 inertia{};                      // principal moments, and the mass
    Quad3 seen_inertia{};                 // those that impulses find
    Quad3 anchor{}, axis{};               // of its joint, from the parent's own, in its frame
    Quad3 centre{};                       // from its anchor, in its own frame
    std::array<QuadMatrix, 3> turning{};  // R_parent^T R = [0] + cos [1] + sin [2], of a hinge
  };
  struct Coordinate {
    double cosine = 1, sine = 0;  // of a hinge
    Quaternion q;                 // of a ball and a free part: R
    Quad3 x{};                    // of a free part: O
  };
  struct Place {
    QuadMatrix R = QuadMatrix::identity();
    Quad3 O{}, d{}, c{}, axis{};
    Quad3 x{};  // the centre of mass, O + c
  };
  // Of velocity, or a small displacement: of O, angular, and of the angle of a hinge.
  struct Rate {
    Quad3 linear{}, angular{};
    double angle = 0;
  };
  struct Momentum {
    Quad3 linear{}, angular{};  // angular: about the centre of mass
  };

  explicit ArticulatedTree(std::vector<Part> parts);
  std::size_t size() const { return parts_.size(); }
  std::vector<Part>& parts() { return parts_; }
  const std::vector<Part>& parts() const { return parts_; }

  void place(std::span<const Coordinate> coordinates, std::span<Place> places) const;
  // Coordinates after a time h with the rates, by Cayley's map.
  void advance(std::span<const Rate> rates, double h, std::span<Coordinate> coordinates) const;
  // Of the motion from one place to the other in h; and its turns R0 f, unless that is empty.
  void find_momenta(std::span<const Place> from, std::span<const Place> to, double h,
                    std::span<Momentum> momenta, std::span<Quad3> turns = {}) const;

  // Articulated inertias.
  void factor(std::span<const Place> places);
  // The rates whose momenta are the given ones, but for what joints give; by the last factor().
  void respond(std::span<const Momentum> momenta, std::span<Rate> rates);
  // Of those rates.
  Momentum momentum(std::size_t part, const Place& place, const Rate& rate) const;

 private:
  struct Articulated {
    QuadMatrix J{}, H{}, M{};
  };
  // What respond() needs of a part, side by side.
  struct Response {
    Quad3 d{}, c{};
    Quad3 axis{}, torque{}, force{};  // of a hinge: [J; H^T] axis
    double inverse = 0;               // of its own inertia
  };
  struct Inverse {             // of a ball and a free part
    QuadMatrix J{}, K{}, M{};  // J^-1, J^-1 H, and that of M without what J takes
  };
  void reduce(std::size_t part, const Place& place);

  std::vector<Part> parts_;
  std::vector<Articulated> articulated_;
  std::vector<Response> response_;
  std::vector<Inverse> inverse_;
  std::vector<Momentum> wrench_;  // about anchors
  std::vector<double> angle_;
};

}  // namespace substep::rigid
