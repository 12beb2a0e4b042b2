// The grid's part of a step: momentum becomes velocity, gravity and obstacles act.
//
// The order of the calls in a step:
//   set_layout (after a sort); update (all checks passed? else the step has not happened);
//   the G2P or the fused G2P2G, which calls particles().settle() for packets of near blocks;
//   finish, which moves the colliders by dt and adds what they were given to their exchange().
// A run of steps begins with clear_exchange(), so that exchange() is the sum of a run.
//
// Obstacles. A node whose signed distance is below `reach` (0: in the obstacle, or on its surface)
// takes the collider's condition (boundary.h). So material is held from where its splines touch
// the obstacle; what comes through between the nodes is stopped at the surface itself, particle by
// particle (particle_boundary.h). Impulses and torques are summed per chunk of node blocks and
// per particle block, then in their order: the same bits for any number of threads. In two
// dimensions the obstacles are those of space cut at z = 0.
//
// Obstacles that yield: update() finds the velocities of their bodies together with those of the
// nodes in them (body_contacts.h), and with these they move in this step. A node in other obstacles
// too takes their conditions after that. What particles give at the surface changes the velocity in
// finish(), for the next step.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/mpm/boundary/body_contacts.h"
#include "substep/mpm/boundary/boundary.h"
#include "substep/mpm/boundary/node_distances.h"
#include "substep/mpm/boundary/particle_boundary.h"
#include "substep/transfer/blocks.h"

namespace substep::mpm {

// What update() found.
struct NodeCheck {
  double speed = 0;            // the largest component of a node's velocity [m/s]
  double reach = 0;            // no particle moves by more along an axis in this step [cells]:
                               // speed dt / dx, and the colliders' own way where they push
  std::int64_t bad_node = -1;  // the first whose velocity is not finite or faster than the bound:
                               // node block * NodeBlocks::kNodes + node; -1: none
  bool good() const { return bad_node < 0; }
};

template <class Real, int D>
class GridUpdate {
 public:
  // cell: dx [m]; boundaries: one per collider; reach: distance from a surface within which nodes
  // take its condition [m].
  GridUpdate(double cell, std::vector<geometry::Collider> obstacles,
             std::vector<Boundary> boundaries, double reach = 0);

  std::vector<geometry::Collider> colliders;  // set their pose and motion between steps

  // After every sort. The layout must live until the next call. Where it throws, nothing changes.
  void set_layout(const transfer::BlockLayout<D>& layout, int threads) {
    set_layout(layout, walls_of(layout, threads));
  }
  // The same in two parts: all that may fail, before a layout is taken over, and the rest.
  ParticleBoundary<Real, D> walls_of(const transfer::BlockLayout<D>& layout, int threads) const;
  void set_layout(const transfer::BlockLayout<D>& layout,
                  ParticleBoundary<Real, D>&& walls) noexcept;

  // nodes: of NodeBlocks of the layout, per node (p or v (D), mass at index D, padding). Turns
  // momentum into velocity (0 where there is no mass), adds gravity [m/s^2] dt, applies the
  // colliders' conditions. speed_bound [m/s] on every component.
  NodeCheck update(std::span<Real> nodes, const geometry::Vec3& gravity, double dt,
                   double speed_bound, int threads);

  // Velocities of nodes that are not the material's own take the conditions of the last update(),
  // which gives nothing to the colliders.
  void hold(std::span<Real> nodes, int threads) const;

  // Which nodes take which collider's condition, for methods that find v by other means (implicit
  // integration).
  const NodeDistances<Real, D>& distances() const { return distances_; }
  // The greatest surface speed of a collider that is near to material [m/s]: counts for the CFL
  // condition like the speed of particles.
  double collider_speed() const;

  // Keeps particles out of the colliders, whose pose goes through the step that update() began.
  ParticleBoundary<Real, D>& particles() { return particles_; }

  void clear_exchange();
  // Ends the step. Returns by how much some particle went further than NodeCheck::reach [cells], at
  // most ParticleBoundary::kPush: leave that to spare, and count it as drift.
  double finish();

 private:
  static constexpr std::int64_t kGrain = 32;  // node blocks per chunk

  // A surface that holds nodes of a block.
  struct Holder {
    std::size_t collider;
    const typename NodeDistances<Real, D>::Patch* patch;
  };
  // What a task found in its chunk of node blocks.
  struct Found {
    Real speed = 0;
    std::int64_t bad_node = -1;
    std::vector<std::int32_t> met;  // blocks with nodes in obstacles that yield
    std::vector<BodyContact> contacts;
    std::vector<double> masses;  // of the blocks that each collider comes near to [kg]
  };
  Found update_blocks(std::int64_t begin, std::int64_t end, Real* nodes,
                      const geometry::Vec3& gravity_dt, Real bound,
                      geometry::Exchange* parts) const;
  static bool judge(std::int64_t node_block, Real limit, const Real* nodes, Found& found);
  void find_holders(std::int32_t node_block, std::vector<Holder>& holders) const;
  std::span<const Holder> fixed(std::vector<Holder>& holders) const;
  bool other_is_nearer(std::span<const Holder> holders, const Holder& holder, int node) const;
  void find_contacts(std::int32_t node_block, std::span<const Holder> holders, const Real* nodes,
                     Found& found) const;
  void meet_bodies(std::vector<Found>& found, Real* nodes, Real bound, int threads);
  // The colliders with their velocities in this step.
  const std::vector<geometry::Collider>& moving() const {
    return bodies_.any() ? bodies_.moving() : colliders;
  }
  void hold(std::int32_t node_block, std::span<const Holder> holders, Real* nodes,
            geometry::Exchange* parts) const;

  double cell_, dt_ = 0;
  std::vector<Boundary> boundaries_;
  const transfer::BlockLayout<D>* layout_ = nullptr;
  bool layout_changed_ = false;
  NodeDistances<Real, D> distances_;
  ParticleBoundary<Real, D> particles_;
  Bodies bodies_;
  std::vector<geometry::Exchange> parts_;  // of chunk k and collider c at k * colliders + c
};

}  // namespace substep::mpm
