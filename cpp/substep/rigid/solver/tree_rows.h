// What the bodies of a tree (tree_group.h) and their rows of a step (body_rows.h) tell each other,
// in lanes: momenta become velocities in the coordinates of rows, and what others, contacts, made
// of rows is read back.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/rigid/motion/body_lanes.h"
#include "substep/rigid/solver/articulated_tree.h"

namespace substep::rigid {

class TreeRows {
 public:
  using Tree = ArticulatedTree;

  explicit TreeRows(std::size_t bodies);

  // At the begin of a step: where the body and its row are, and W^(1/2) and its inverse then.
  void set(std::size_t body, std::int32_t row, const BodyRows& rows, const Quad3& position,
           const QuadMatrix& unroot);
  // The velocities of the rows are those of now; the spins are of the momenta.
  void begin_step(const Tree& tree, std::span<Tree::Momentum> momenta, BodyRows& rows);

  // Forces alone, for a time that may be negative.
  void kick(double time, const BodyRows& rows, std::span<Tree::Momentum> momenta) const;
  // Returns whether others changed the velocities.
  bool read(const BodyRows& rows, std::span<Tree::Momentum> momenta);
  // What the momenta are as velocities; spins alone: those of linear momenta are known to be.
  void show(const Tree& tree, std::span<const Tree::Momentum> momenta, BodyRows& rows);
  void show_spins(const Tree& tree, std::span<const Tree::Momentum> momenta, BodyRows& rows);
  // The same of momenta that joints gave, which others' changes are then apart from.
  void give(const Tree& tree, std::span<const Tree::Momentum> momenta, BodyRows& rows);
  // The spin of one body alone, which is for joints to withdraw as well.
  void give_spin(const Tree& tree, std::size_t body, std::span<const Tree::Momentum> momenta,
                 BodyRows& rows);
  // Takes from the rows what joints gave them in the sub-step before.
  void withdraw(BodyRows& rows);

  // Displacements of centres and turns of the rows other than those shown, after h of the
  // velocities that joints gave; or, of velocities, in h. Returns whether there are any.
  bool find_displacements(const BodyRows& rows, double h, std::span<Tree::Momentum> aside) const;
  bool find_drifts(const BodyRows& rows, double h, std::span<Tree::Momentum> aside) const;
  // Bodies are at the places, turned there from where they were.
  void show_places(std::span<const Tree::Place> places, std::span<const Quad3> turns,
                   BodyRows& rows);
  // The step ends at these places, of a tree that nothing touches.
  void end_step(std::span<const Tree::Place> places, BodyRows& rows) const;

 private:
  using V = LanesOfBodies;
  using V3 = Vector3<V>;
  static constexpr int kLanes = sizeof(V) / sizeof(double);

  // As many bodies as there are lanes; where fewer are left, the last is there again.
  struct Lot {
    std::int32_t row[kLanes];
    V scale;  // 1 / sqrt(m)
    V3 root[3], unroot[3], origin;
    BodyLanes seen{};            // velocities of the rows
    BodyLanes from_joints{};     // those that joints gave
    BodyLanes seen_displaced{};  // displacements of the rows
    BodyLanes given{};           // what joints changed of the velocities, in the sub-step
  };
  template <class Call>
  void for_lanes(std::size_t body, const Call& call);
  std::size_t body(std::size_t lot, int lane) const;
  BodyLanes load(const Lot& lot, const BodyRows::Rows& rows) const;
  void store(const BodyLanes& lanes, const Lot& lot, BodyRows::Rows& rows) const;
  BodyLanes gather(std::span<const Tree::Momentum> momenta, std::size_t lot) const;
  void scatter(const BodyLanes& lanes, std::size_t lot, std::span<Tree::Momentum> momenta) const;
  V3 spin(const Tree& tree, std::size_t lot, const V3& L) const;

  std::size_t bodies_;
  std::vector<Lot> lots_;
};

}  // namespace substep::rigid
