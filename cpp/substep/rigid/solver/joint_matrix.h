// The equations of bodies and joints of one group, factored without pivoting.
//
// With the gradients G of the rows of all joints in coordinates in which bodies have mass and
// inertia 1 (body_rows.h), impulses l and changes of velocity dv fulfil
//   [ 1   G^T ] [ dv ]   [  0 ]
//   [ G   -E  ] [ -l ] = [ -c ]
// a symmetric matrix of blocks: a node for each body and each joint. It is factored as A = L D L^T
// by blocks, D definite in each: positive of bodies, negative of joints. A joint comes after all of
// its bodies, or after one that no other joint was left at: then what it holds is that body's to
// give, and its block is as definite as it can be. (Any order would do for E > 0, quasidefinite:
// Vanderbei 1995, SIAM J. Optim. 5; but with pivots as small as E.) Of all such orders that of
// least fill is sought (minimum degree): leaves first, so a tree has no fill, and its cost is
// linear (Baraff 1996, "Linear-time dynamics using Lagrange multipliers", SIGGRAPH, section 6);
// loops fill as they must. E > 0, tiny but for springs, is for loops with more equations than
// motions.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/core/usize.h"
#include "substep/rigid/motion/body_pair.h"

namespace substep::rigid {

class JointMatrix {
 public:
  static constexpr int kSize = 6;
  struct alignas(64) Piece : std::array<double, 8> {};  // the last two are none

  // Bodies 0 ... bodies - 1, each with six coordinates; joint j connects two of them, or one and
  // what no impulse moves (-1), by rows[j] rows.
  void analyse(std::int32_t bodies, std::span<const BodyPair> joints, std::span<const int> rows);

  // Bodies without joints. Then the rows of G and the diagonal of E, each of them; G = 0 for none.
  void clear();
  void set(std::int32_t joint, int row, const Piece& gradient_a, const Piece& gradient_b, double E);

  void factor();
  // c of each joint; becomes l, 0 in rows that were not set.
  void solve(std::span<Piece> joints);

 private:
  // Column after column, each with two entries more: two vectors of four.
  static constexpr int kColumn = 8;
  struct alignas(64) Block {
    double entry[kSize * kColumn];
  };
  struct alignas(64) Column {
    double entry[kColumn];
  };

  struct Node {
    std::int32_t id;            // body, or bodies_ + joint
    int size;                   // of its block
    std::int32_t first, count;  // in below_
  };
  struct Below {
    std::int32_t id, block;
  };
  struct Side {
    std::int32_t block;  // -1: none
    bool transposed;     // the joint comes before the body
  };
  std::span<const Node> units() const { return std::span(order_).first(usize(units_)); }
  std::span<const Node> others() const { return std::span(order_).subspan(usize(units_)); }
  void place(std::span<const BodyPair> joints);
  void put(const Side& side, int row, const Piece& gradient);

  std::int32_t bodies_ = 0;
  std::vector<Node> order_;
  std::int64_t units_ = 0;            // of them, bodies of one joint, which come first: D = 1
  std::int32_t filled_ = 0;           // first block below others
  std::vector<Below> below_;          // nodes that come later, of each node, in their order
  std::vector<std::int32_t> update_;  // of each pair of them: its block
  std::vector<Side> side_a_, side_b_;
  std::vector<int> size_;        // by id
  AlignedBuffer<Block> blocks_;  // becomes D^-1, L
  AlignedBuffer<Block> before_;  // of the nodes below one: the block, and so L D
  AlignedBuffer<Column> x_;
};

}  // namespace substep::rigid
