// Keeps particles out of obstacles at the end of a step, where the grid's condition alone did not:
// between nodes, at walls thinner than a cell, at corners, before fast ones.
//
// A particle that was free goes from where it was to where the grid moves it, in the frame of each
// collider, which moves and turns meanwhile, and ends at least `margin` outside
// (geometry/conservative_advancement.h). Where that took anything away, its velocity takes the
// collider's condition (boundary.h) at once, and the impulse m dv is the collider's. A particle
// that was inside already, as where a collider was put upon it, is pushed out by up to kPush cells
// a step, without an impulse.
//
// A body that yields is taken apart for that, evenly by mass: a particle meets its share of it as
// if it were alone, in an inelastic collision, and afterwards the shares are one body again. So
// however light the body is, neither loses more than both meeting at once would: energy never
// grows. A light body then takes more than one step to stop what the grid does not see.
//
// Only particle blocks that a collider comes near to are looked at (near()), and there only the
// particles that are not surely free: on the free side of the tangent plane of a convex solid,
// between two walls of a tank, within a ball that keeps clear.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "substep/core/usize.h"
#include "substep/geometry/bounding_balls.h"
#include "substep/geometry/collider.h"
#include "substep/mpm/boundary/boundary.h"
#include "substep/mpm/boundary/surfaces.h"
#include "substep/mpm/particles/particles.h"
#include "substep/transfer/blocks.h"

namespace substep::mpm {

template <class Real, int D>
class ParticleBoundary {
 public:
  static constexpr double kMargin = 1e-3;  // cells that particles keep from a surface
  static constexpr double kPush = 0.02;    // cells

  ParticleBoundary(double cell, std::vector<Boundary> boundaries)
      : cell_(cell), boundaries_(std::move(boundaries)) {}

  // For a step of dt that begins with the colliders as they are here. masses: where some yield, of
  // the material near to the body of each [kg].
  void begin_step(const transfer::BlockLayout<D>& layout, bool layout_changed,
                  std::span<const geometry::Collider> colliders, std::span<const double> masses,
                  double dt, int threads);
  // How far along an axis a particle may go in this step, kPush aside [cells].
  void set_reach(double reach) { reach_ = reach; }
  double reach() const { return reach_; }

  // Whether particles of particle block b may touch a collider in this step.
  bool near(std::int32_t block) const { return !near_.empty() && slots_[usize(block)] >= 0; }

  // One packet of a near block, after its velocity v is gathered and x advanced, both of which may
  // change: number d of lane l at [d * kLanes<Real> + l], x in cells from the arena's first node.
  // `before`: x before the step. volume: V_0 of each lane, density: rho_0. Lanes from `count` on
  // repeat the last particle: they move with it and exchange nothing. C and F stay as they are.
  // Safe from tasks that each have blocks of their own.
  void settle(std::int32_t block, const Real* before, Real* x, Real* v, const Real* volume,
              double density, int count);

  // After all packets: what each collider was given, and by how much some particle went beyond the
  // reach [cells].
  std::span<const geometry::Exchange> sum_exchanges() noexcept;
  double excess() const;
  // The greatest surface speed of a moving collider near to particles [m/s].
  double collider_speed() const { return collider_speed_; }

 private:
  static constexpr double kHalf = 3.5;  // cells from the middle of an arena to its last nodes

  // Space where a surface surely is not, in cells from the first node of an arena.
  struct Free {
    enum Kind { kNowhere, kHalfSpace, kSlab, kBall } kind = kNowhere;
    // kHalfSpace: row.(x, 1) >= 0; kSlab: |row.(x, 1)| <= size; kBall: |x - row|^2 <= size.
    Real row[4] = {};
    Real size = 0;
  };
  struct Wall {
    Surface surface;
    Free free;
    geometry::Exchange part;
  };
  struct Near {
    std::int32_t block = 0;
    geometry::Vec3 first;  // node of the arena, in the world
    std::vector<Wall> walls;
    double excess = 0;
  };

  using V = Vector<Real>;
  using Mask = Vector<IntOf<Real>>;

  geometry::Vec3 first_node(std::uint64_t key) const;
  geometry::Vec3 middle_of(const geometry::Vec3& first) const;  // of an arena
  geometry::BoundingBalls balls_with_ways(std::span<const Surface> all) const;
  bool comes_near(const geometry::Collider& to, int axis, const geometry::Vec3& first,
                  Free& free) const;
  double surface_speed(const geometry::Collider& collider, const geometry::Vec3& centre,
                       double radius) const;
  static Mask outside(const Free& free, const Real* x);
  static bool outside(const Free& free, const geometry::Vec3& x);
  bool clears(const Near& near, const Wall& wall, const Real* before, const Real* x) const;
  double share(const geometry::Collider& collider, std::size_t c, const geometry::Vec3& x,
               const geometry::Vec3& jump) const;
  bool settle_one(Near& near, const geometry::Vec3& before, geometry::Vec3& x, geometry::Vec3& v,
                  double mass) const;

  double cell_, reach_ = 0, collider_speed_ = 0, dt_ = 0;
  std::vector<Boundary> boundaries_;
  std::vector<geometry::Collider> from_, to_;  // as the step begins and as it ends
  std::vector<std::int32_t> slots_;            // of each particle block: place in near_, or -1
  std::vector<Near> near_;                     // ascending blocks
  std::vector<double> masses_;                 // as given to begin_step
  std::vector<geometry::Exchange> sums_;       // of each collider
};

}  // namespace substep::mpm
