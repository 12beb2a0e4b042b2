// What sweeps over single faces are slow at: motions of large parts of a viscous liquid, which
// nearly rigid ones cost little energy. So a coarse matrix for the rigid motions of blocks of 4^D
// cells (Galerkin's: P^T A P), that of blocks twice as large, and so on, until few blocks are left
// to be solved for directly. A V-cycle with sweeps of Gauss-Seidel over the blocks.
//
// Aggregation with rigid motions: Vanek, Mandel and Brezina, "Algebraic multigrid by smoothed
// aggregation for second and fourth order elliptic problems", Computing 56, 1996, without their
// smoothing of P; corrections are enlarged instead (Braess, "Towards algebraic multigrid for
// elliptic problems of second order", Computing 55, 1995).
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/viscosity/velocity_rows.h"

namespace substep::gridfluid {

template <int D>
class RigidBlocks {
 public:
  // Numbers of a motion: a velocity and what it gains over half a block by turning.
  static constexpr int kMotions = D == 2 ? 3 : 6;
  using Motion = Eigen::Matrix<double, kMotions, 1>;
  using Pair = Eigen::Matrix<double, kMotions, kMotions>;

  void find(const VelocityRows<D>& rows, int threads);
  // x += P M P^T r, with M the V-cycle, for the faces.
  void correct(const VelocityRows<D>& rows, std::span<const double> r, std::span<double> x,
               int threads);

 private:
  using Place = std::array<int, D>;
  static constexpr int kNear = D == 2 ? 9 : 27;  // blocks that one may meet, itself among them

  struct Level {
    Place extent;                       // of the box, in blocks
    std::vector<Place> place;           // of each block, ordered by colour
    std::vector<std::int64_t> colours;  // where each ends
    // What it is made of: faces, or blocks of the level before.
    std::vector<std::int64_t> member_end;
    std::vector<std::int32_t> member;
    // kNear each: those that it meets, then -1, and the matrix there.
    std::vector<std::int32_t> other;
    std::vector<Pair> value;
    std::vector<Pair> own, inverse;  // with the block itself
    std::vector<Motion> r, x;

    std::int64_t size() const { return static_cast<std::int64_t>(place.size()); }
    Pair& at(std::int64_t block, std::int32_t with);
    Motion others(std::int64_t block) const;  // their part of A x
    void sweep(bool forwards, int threads);
  };

  // Blocks of so many items at places; returns that of each.
  template <class PlaceOf>
  std::vector<std::int32_t> group(std::int64_t items, const PlaceOf& place_of,
                                  const std::array<bool, D>& periodic, Level& level) const;
  template <class Add>
  void find_matrix(Level& level, const Add& add, int threads) const;
  void coarsen(const std::array<bool, D>& periodic, int threads);
  void solve_last();
  void cycle(std::size_t l, int threads);
  static Motion of_face(const VelocityRows<D>& rows, std::int64_t row, const Place& block);
  static Pair of_parent(const Place& block);

  std::vector<std::vector<std::int32_t>> block_of_;  // of each face, of each block of a level
  std::vector<Level> levels_;
  Eigen::LDLT<Eigen::MatrixXd> direct_;  // of the last level
};

extern template class RigidBlocks<2>;
extern template class RigidBlocks<3>;

}  // namespace substep::gridfluid
