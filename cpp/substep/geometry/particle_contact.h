// Particles and colliders: moves particles so that none passes an obstacle, with Coulomb friction
// and restitution, and sums what the obstacles were given.
//
// A particle goes from where it was when the substep began to where the method wants it, in the
// frame of each collider, which moves and turns meanwhile; advance_freely() says how far it gets.
// Impulses are those of position-based dynamics: a correction D of the position in a substep h is
// the impulse m D / h on the particle, minus that on the collider.
//
// Friction (Mueller et al., "Detailed rigid body simulation with extended position based dynamics",
// 2020, section 3.5; Macklin et al., "Unified particle physics", 2014, section 6.1), with the sum N
// of the normal corrections of the substep and the way s of the particle along the surface since
// the substep began: the sum T of the frictional ones becomes T - s, cut to |T| <= friction |N|.
// Below the bound the particle sticks. Unlike theirs, N and T are sums over the iterations, so that
// Coulomb's law holds for the impulses of the whole substep. Across an edge N is a vector sum.
//
// Restitution (Mueller et al. 2020, eq. 34) acts on the velocities, once: bounce().
//
// Order of the calls, for a method with any number of substeps and iterations:
//   begin_step; (begin_substep, clear at the first one, project ..., bounce) ...; end_step.
#pragma once

#include <compare>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/point.h"
#include "substep/geometry/bounding_balls.h"
#include "substep/geometry/collider.h"

namespace substep::geometry {

template <class Real>
class ParticleContact {
 public:
  // Positions are relative to `origin`. The particles keep `margin` > 0 from the obstacles [m].
  // In two dimensions z stays as it is.
  ParticleContact(std::vector<Collider> obstacles, const Vec3& origin, double margin,
                  int dimension = 3);

  // Their motion and exchange are those of the last step; set positions and velocities between
  // steps.
  std::vector<Collider> colliders;
  int threads = 0;
  // The part of what project() moves that becomes velocity, and so is an impulse. Below 1 friction
  // is left to slide().
  double share = 1;

  // Of n particles. mass [kg]: of each, or one for all; particles of mass 0 are held by the method
  // and pass through.
  void begin_step(std::int64_t n);

  // Takes out particles that lie nearer than the margin as the substep begins, as where a collider
  // was put upon them; the points of `along`, if there are any, move by the same. So they do not
  // fly off: that is no impulse. Returns whether any were inside, of more than a facet: those are
  // thin, and put where they are in each interval of exchange.
  bool clear(std::span<Point<Real>> x, std::span<const Real> mass,
             std::span<Point<Real>> along = {});

  // Colliders advance by h.
  void begin_substep(double h);

  // start: positions when the substep began; x: where the particles want to go, and then go.
  void project(std::span<const Point<Real>> start, std::span<Point<Real>> x,
               std::span<const Real> mass);

  // Friction on the velocities v at the end of the substep, for a method whose pressure changes
  // velocities: what T lacks of stopping a particle that was pushed by N, cut to friction |N|.
  void slide(std::span<const Point<Real>> x, std::span<Point<Real>> v, std::span<const Real> mass);

  // v: velocities after the substep, v_start: before it and before gravity. For particles that
  // touched, the normal velocity relative to the surface becomes at least restitution times that
  // of the impact. Particles that just rest do not bounce.
  void bounce(std::span<const Point<Real>> start, std::span<const Point<Real>> v_start,
              std::span<Point<Real>> v, std::span<const Real> mass);

  // Sets the colliders' exchange() to the sums of the step.
  void end_step();

  // A method that pushes particle i off collider c by other means than project (a pressure) says
  // so here: `push` [m] is the correction of the position in this substep, which counts as an
  // impulse on the collider and as a normal correction for friction. Safe from tasks over chunks
  // of kGrain particles, but for obstacles that yield.
  void add_push(std::size_t c, std::int64_t i, const Point<Real>& x, const Vec3& push, double mass);

  // Obstacles that yield are left to the method, which solves for their motion: project(), slide()
  // and bounce() pass them by. The push [m] that a particle on its way from `start` to x needs so
  // as not to enter collider c, and the sum of those that add_push() told of.
  Vec3 way_off(std::size_t c, const Point<Real>& start, const Point<Real>& x) const;
  Vec3 pushed(std::size_t c, std::int64_t i) const;
  // An impulse at x. What the collider was given since the last call, about its position. And: its
  // pose at the end of the substep is another one now.
  void add_impulse(std::size_t c, const Point<Real>& x, const Vec3& impulse);
  Exchange take(std::size_t c);
  void moved(std::size_t c);

  // A collider, and a particle that may be near to it.
  struct Near {
    std::int32_t collider, particle;
    auto operator<=>(const Near&) const = default;
  };
  // Those that may be nearer than `reach` >= margin: all that are, and few others. Of each chunk of
  // kGrain particles, ascending.
  std::vector<std::vector<Near>> find_near(std::span<const Point<Real>> x, double reach) const;
  // The pose of the colliders for find_near() outside of a step.
  void place();

  double margin() const { return margin_; }
  const Vec3& origin() const { return origin_; }
  static constexpr std::int64_t kGrain = 1024;  // particles per task

 private:
  // Takes positions relative to the origin into the frame of a collider.
  struct Pose {
    Mat3 rotation = Mat3::Identity();  // body to world
    Vec3 shift = Vec3::Zero();         // origin minus the collider's position

    Vec3 to_local(const Vec3& x) const { return rotation.transpose() * (x + shift); }
    Vec3 to_world(const Vec3& local) const { return rotation * local - shift; }
  };
  struct Obstacle {
    Pose from, to;      // when the substep began, and at its end
    Vec3 middle;        // of a ball about it at the end of the substep, relative to the origin,
    double radius = 0;  // which may be infinite
    double shifted = 0, turned = 0;  // how far its frame went; of its axes
    bool aligned = false;            // free space is low <= x <= high
    Point<Real> low, high;           // relative to the origin, with the margin
    bool tracked = false;            // friction or restitution: N and T are kept
    bool yields = false;
    std::vector<Point<Real>> normal, tangential;  // N and T of each particle, in its frame
    std::vector<char> pushes;                     // any N in each chunk
    // One per chunk; of those that yield: what was not taken yet, and what was.
    std::vector<Exchange> parts;
  };

  Pose pose(const Collider& collider) const;
  // The same of one collider, for the particles of [begin, end).
  void find_near(std::size_t c, std::span<const Point<Real>> x, std::int64_t begin,
                 std::int64_t end, double reach, std::vector<std::int32_t>& found) const;
  // Among the colliders `around`, which are not aligned: their numbers, ascending.
  void find_among(const BoundingBalls& balls, std::span<const std::int32_t> around,
                  std::span<const Point<Real>> x, std::int64_t begin, std::int64_t end,
                  double reach, std::vector<Near>& found) const;
  void find_in_ball(std::size_t c, const Pose& at, std::span<const Point<Real>> x,
                    std::int64_t begin, std::int64_t end, double reach,
                    std::vector<std::int32_t>& found) const;
  Vec3 way_out(std::size_t c, const Vec3& x) const;
  void set_bounds(std::size_t c);
  void clamp(std::size_t c, std::span<const Point<Real>> start, std::span<Point<Real>> x,
             std::span<const Real> mass, std::int64_t begin, std::int64_t end);
  // Balls about the particles of a range, before and after their ways.
  struct Ways;
  Ways ways(std::span<const Point<Real>> start, std::span<const Point<Real>> x, std::int64_t begin,
            std::int64_t end) const;
  // These two return whether they moved any.
  bool settle_near(std::size_t c, std::span<const Point<Real>> start, std::span<Point<Real>> x,
                   std::span<const Real> mass, std::int64_t begin, std::int64_t end,
                   const Ways& of_range);
  bool settle(std::span<const Point<Real>> start, std::span<Point<Real>> x, double mass,
              std::int64_t i);
  Vec3 rub(std::size_t c, std::int64_t i, const Vec3& start, const Vec3& p, const Vec3& push);
  // Where particle i was known to be free, and the pose of an obstacle then.
  bool from_start() const { return first_ || !keep_reached_; }
  const Point<Real>& free_before(std::span<const Point<Real>> start, std::int64_t i) const {
    return from_start() ? start[i] : reached_[i];
  }
  const Pose& pose_before(const Obstacle& obstacle) const {
    return from_start() ? obstacle.from : obstacle.to;
  }

  Vec3 origin_;
  double margin_;
  bool planar_;
  double h_ = 0;
  bool first_ = true;  // no project yet in this substep
  std::vector<Obstacle> obstacles_;
  std::vector<Point<Real>> reached_;  // after the last project; kept where free space is not convex
  bool keep_reached_ = false;
};

}  // namespace substep::geometry
