// Bodies that joints connect to a tree, in the coordinates that the joints leave free.
//
// A part is a body with the joint that holds it to its parent: a hinge turns by an angle, a slider
// goes along an axis, a ball turns by a rotation, a fixed joint does not move; the first part may
// hang from nothing and moves freely, or from the world. Its anchor O is where its joint is (of a
// free part: its centre of mass), d the vector to O from the anchor of its parent, c that from O to
// the centre of mass.
//
// The motion over a time h is that of the discrete Lagrangian
//   sum of m |x1 - x0|^2 / (2 h) + f . I f / (2 h),   f = log(R0^T R1),
// of all bodies: its momenta are P = m (x1 - x0) / h and, with J the left rates of the logarithm,
// L = R0 J^-T I f / h (Marsden and West 2001, "Discrete mechanics and variational integrators",
// Acta Numerica 10; Bou-Rabee and Marsden 2009, "Hamilton-Pontryagin integrators on Lie groups",
// Found. Comput. Math. 9, for the exponential). The coordinates are such that P and L differ from
// given ones by what joints can give, that is, by nothing along the free motions (the discrete
// Euler-Lagrange equations; Lee, Liu, Park and Srinivasa 2018, "A linear-time variational
// integrator for multibody systems", WAFR). They are found by Newton's method. Momenta change with
// the end of the motion, and count by the motions free at its begin, so that the matrix is N0^T K
// N1 with the motions N of the joints at both, factored as by the articulated-body algorithm
// (Featherstone 2008, "Rigid Body Dynamics Algorithms", ch. 7) about each part's anchor and in the
// axes of the world, but not symmetric:
//   [ torque about O ]   [ J  H ] [ angular rate ]
//   [ force          ] = [ G  M ] [ rate of O    ].
// Of a body dP = m (dO + dw x c1) and, but for f^2, dL = (I - h / 2 [L]) dw with its inertia I in
// the middle. Of velocities, both ends are one place and L counts for nothing.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/matrix3.h"
#include "substep/core/usize.h"
#include "substep/rigid/solver/quad_vectors.h"

namespace substep::rigid {

class ArticulatedTree {
 public:
  enum class Kind : std::uint8_t { kFree, kHinge, kSlider, kBall, kFixed };

  struct Part {
    Kind kind = Kind::kFree;
    std::int32_t parent = -1;             // comes before it; -1: the world, or nothing
    Quad3 inertia{};                      // principal moments, and the mass
    Quad3 seen_inertia{};                 // those that impulses find,
    bool slow = false;                    // where they are others
    Quad3 anchor{}, axis{};               // of its joint, from the parent's own, in its frame
    Quad3 centre{};                       // from its anchor, in its own frame
    std::array<QuadMatrix, 3> turning{};  // R_parent^T R = [0] + cos [1] + sin [2], of a hinge
  };
  struct Coordinate {
    double cosine = 1, sine = 0;  // of a hinge
    double way = 0;               // of a slider
    Quaternion q;                 // of a ball and a free part: R, of any length
    Quad3 x{};                    // of a free part: O
  };
  struct alignas(64) Place {
    QuadMatrix R = QuadMatrix::identity();
    Quad3 x{};  // the centre of mass, O + c
    Quad3 O{}, d{}, c{}, axis{};
  };
  // Of velocity, or a small displacement: of O, angular, and along the coordinate of a hinge or a
  // slider.
  struct Rate {
    Quad3 linear{}, angular{};
    double along = 0;
  };
  struct alignas(64) Momentum {
    Quad3 linear{}, angular{};  // angular: about the centre of mass
  };
  // What acts along the coordinate of a hinge or a slider besides: where held, what changes its
  // rate by `change`; else an impulse, less stiffness times that change.
  struct Drive {
    bool held = false;
    double change = 0, impulse = 0, stiffness = 0;
  };

  explicit ArticulatedTree(std::vector<Part> parts);
  std::size_t size() const { return parts_.size(); }
  std::vector<Part>& parts() { return parts_; }
  const std::vector<Part>& parts() const { return parts_; }
  Drive& drive(std::size_t part) { return drives_[part]; }

  void place(std::span<const Coordinate> coordinates, std::span<Place> places) const;
  // Coordinates after a time h with the rates, by Cayley's map.
  void advance(std::span<const Rate> rates, double h, std::span<Coordinate> coordinates) const;
  // Rotations become of length 1 again.
  void normalize(std::span<Coordinate> coordinates) const;
  // Motions begin there.
  void begin(std::span<const Place> from);
  // Kinetic, at that begin.
  double energy(std::span<const Momentum> momenta) const;
  // Of the motion to there in h.
  void find_momenta(std::span<const Place> to, double h, std::span<Momentum> momenta) const;
  // Its turns R0 f; the next motion begins there.
  void find_turns(std::span<const Place> to, std::span<Quad3> turns);

  // Articulated inertias, of the motion with these momenta, or of velocities at a place, with what
  // is held and the stiffness of drives.
  void factor(std::span<const Place> from, std::span<const Place> to, double h,
              std::span<const Momentum> momenta);
  void factor(std::span<const Place> places) { factor(places, places, 0, {}); }
  // The rates whose momenta are the given ones, but for what joints give; by the last factor().
  void respond(std::span<const Momentum> momenta, std::span<Rate> rates);
  // Of a drive, with those rates.
  double impulse(std::size_t part) const { return impulse_[part]; }
  // Of those rates.
  Momentum momentum(std::size_t part, const Rate& rate) const {
    const Own& own = own_[part];
    return {own.mass * (rate.linear + cross(rate.angular, own.c)), own.K * rate.angular};
  }

  // From the anchor, at the end of that motion.
  const Quad3& centre(std::size_t part) const { return own_[part].c; }

  using V = Vector<double>;
  static constexpr int kLanes = sizeof(V) / sizeof(double);
  // Places of as many parts as there are lanes; those that are left have the last part again.
  struct Lot {
    Vector3<V> R[3], x;
    V moments[3], mass;
    V inverse_moments[3], inverse_mass;
    V counts;  // 1, or 0 where the last part is there again
  };
  // Of where motions begin.
  std::span<const Lot> lots() const { return lots_; }

 private:
  Lot gather(std::span<const Place> places, std::size_t first) const;

  struct Articulated {
    QuadMatrix J{}, H{}, G{}, M{};
  };
  struct Own {  // of the body alone
    QuadMatrix K{};
    Quad3 c{};
    double mass = 0;
  };
  // What respond() needs of a part. Of a hinge, with D = a0 . J a1 and the stiffness: [J; G] a1 / D
  // as the parent feels it, and [J^T; H^T] a0 / D of its rates; of a slider, so with [H; M] and
  // [G^T; M^T]; where it is held, not over D.
  struct Response {
    Quad3 c0{}, d0{}, d1{}, a0{}, a1{};
    Quad3 torque{}, force{}, turn{}, shift{};
    double inverse = 0;  // 1 / D; where held, D
  };
  struct Inverse {                    // of a ball and a free part
    QuadMatrix J{}, JH{}, GJ{}, M{};  // J^-1, J^-1 H, G J^-1, and that of M without what J takes
  };
  void reduce(std::size_t part);

  std::vector<Part> parts_;
  std::vector<Lot> lots_;
  std::vector<Own> own_;
  std::vector<Articulated> articulated_;
  std::vector<Response> response_;
  std::vector<Inverse> inverse_;
  std::vector<Momentum> wrench_;  // about anchors
  std::vector<double> along_;
  std::vector<Drive> drives_;
  std::vector<double> impulse_;
};

}  // namespace substep::rigid
