// Bodies among the obstacles that yield to a pressure. Of the pressures q of fluid cells body k
// gets the impulse
//   J_k = m G_k q,
//   G_k q = sum over faces of (1 - A) (q_below - q_above) (e, P ((x - o) x e) + (o - c) x e)
// with the mass m of a full cell, the part 1 - A of the face that is in the body, its middle x and
// axis e, the origin o of the obstacle's frame, P of revolution.h, which is 1 but for what is
// round, and the centre of mass c; q is 0 in cells that are not fluid. With its mobility W it
// moves by V = V* + W J; so A + m sum_k G_k^T W_k G_k takes the place of the matrix A of a
// pressure, and V* is in the right side: Batty, Bertails and Bridson, "A fast variational framework
// for accurate solid-fluid coupling", 2007, section 5, with parts of faces in place of volumes.
//
// Of light bodies that term is far larger than A in few directions, which a preconditioner M of A
// does not know: iterations grow with their number. With the diagonal D of A, C = m W of all bodies
// and any L for which C = L L^T,
//   (D + G^T C G)^-1 = D^-1 - D^-1 G^T T G D^-1,
//   T = L K^-1 L^T,  K = 1 + L^T N L,  N = G D^-1 G^T
// (Woodbury). K couples those bodies alone that are in a cell together, as the triangles of a
// surface are with their neighbours: it is sparse. So with P = G^T T G D^-1,
//   (1 - P)^T M (1 - P) + D^-1 G^T S G D^-1,  S = L K^-2 L^T,
// leaves M as it is where C is small, and takes out of r and z what moves the bodies where it is
// large. It is symmetric and positive.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/gridfluid/grid/cells.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/pressure/obstacles.h"
#include "substep/linalg/direct/supernodal_cholesky.h"

namespace substep::gridfluid {

// Motions of a body in so many dimensions, velocities along axes and of turning: where their
// numbers stand in vectors of six.
template <int D>
constexpr std::array<int, D == 2 ? 3 : 6> kMotionPlaces = {};
template <>
inline constexpr std::array<int, 3> kMotionPlaces<2> = {0, 1, 5};
template <>
inline constexpr std::array<int, 6> kMotionPlaces<3> = {0, 1, 2, 3, 4, 5};

// (e, arm x e) for the axis e: its product with a motion is the velocity along e at `arm` from the
// centre of mass.
template <int D>
auto motion_of(const Vec3& arm, int axis) {
  const geometry::Vec6 all = geometry::wrench(arm, Vec3::Unit(axis));
  return all(kMotionPlaces<D>).eval();
}

// Of an impulse on the body of a collider in such numbers.
template <int D, class Impulse>
geometry::Exchange exchange_of(const Impulse& impulse, const geometry::Collider& collider) {
  geometry::Vec6 j = geometry::Vec6::Zero();
  j(kMotionPlaces<D>) = impulse;
  geometry::Exchange given{j.head<3>(), j.tail<3>()};
  given.torque += (collider.centre() - collider.position()).cross(given.impulse);
  return given;
}

// The colliders of each body that responds to what pushes it.
inline std::vector<std::vector<std::size_t>> responding_bodies(
    std::span<const geometry::Collider> colliders) {
  auto bodies = geometry::colliders_by_body(colliders);
  std::erase_if(bodies, [&](const auto& body) { return !responds(colliders[body[0]]); });
  return bodies;
}

template <class Real, int D>
class Bodies {
 public:
  static constexpr int kMotions = D == 2 ? 3 : 6;
  using Motion = Eigen::Matrix<double, kMotions, 1>;
  using Mobility = Eigen::Matrix<double, kMotions, kMotions>;

  // inverse: of the diagonal of A, 0 in cells that have no pressure; it must live, and not change,
  // as long as this is used.
  void find(const Obstacles<Real, D>& obstacles, std::span<const Real> inverse, double mass,
            int threads);
  bool any() const { return !bodies_.empty(); }

  // y += sign m G^T W G x; returns the product of that with x.
  template <class X>
  double add_product(Real sign, std::span<const X> x, std::span<Real> y, int threads) const;
  // r -= P r; returns y = K^-1 L^T G D^-1 r for add_moved().
  std::vector<double> take_moved(std::span<Real> r, int threads) const;
  // z += D^-1 G^T L K^-1 (y - L^T G z), which is z - P^T z and the part of S.
  void add_moved(std::vector<double> y, std::span<Real> z, int threads) const;
  // Sets exchange() of the colliders of the bodies to what q gives them.
  void push(std::span<const double> q, std::vector<geometry::Collider>& colliders,
            int threads) const;
  // Changes the velocities of the bodies, as set by the last push().
  void move(std::vector<geometry::Collider>& colliders) const;

 private:
  struct Part {  // of G, of a cell with a pressure
    std::int64_t cell;
    Motion motion;
  };
  struct Piece {  // a collider
    std::size_t collider, body;
    std::vector<Part> parts;
  };
  struct Body {
    Mobility c, root;  // C and L
  };

  void find_parts(const Obstacles<Real, D>& obstacles, const std::vector<std::size_t>& piece_of);
  void factorize(int threads);
  std::vector<double> to_roots(const std::vector<Motion>& x) const;    // L^T x
  std::vector<Motion> from_roots(const std::vector<double>& y) const;  // L y
  template <bool kScaled, class X>
  std::vector<Motion> gather(std::span<const X> x, int threads) const;
  template <bool kScaled, class X>
  std::vector<Motion> gather_bodies(std::span<const X> x, int threads) const;
  template <bool kScaled>
  void scatter(const std::vector<Motion>& moved, std::span<Real> y) const;

  double mass_ = 0;
  std::span<const Real> inverse_;  // of D
  std::vector<Body> bodies_;
  std::vector<Piece> pieces_;
  std::unique_ptr<SupernodalCholesky<>> k_;
};

extern template class Bodies<float, 2>;
extern template class Bodies<float, 3>;
extern template class Bodies<double, 2>;
extern template class Bodies<double, 3>;

}  // namespace substep::gridfluid
