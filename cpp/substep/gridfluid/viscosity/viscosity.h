// Viscosity of a liquid with a free surface, implicit: the velocities u of the faces for which
//   sum_f m_f (u_f - u*_f)^2 + 2 k sum_c V_c sum_a e_aa^2 + 4 k sum_e V_e e_ab^2
//   + b k sum_c V_c (div u)_c^2
// is least, with k = nu dt / dx^2, the rates of strain e_aa in cells and e_ab = (d_b u_a + d_a u_b)
// / 2 at edges (in 2D corners), as differences between neighbours, and the volumes of liquid m, V
// around faces, cells and edges: Batty and Bridson, "Accurate viscous free surfaces for buckling,
// coiling, and rotating liquids", 2008, eq. 8. That the surface bears no traction follows; and what
// turns rigidly is left alone.
//
// The last part, with b = 10, is not theirs: without it the pressure that holds against viscous
// stress acts only after that, and a thread that is stretched becomes thinner without resistance.
// With it the velocities stay nearly free of divergence, as the pressure sees that, whose part is
// -b k V_c (div u)_c: a step of an augmented Lagrangian (Fortin and Glowinski, "Augmented
// Lagrangian methods", 1983, chapter 2). Of what it holds against it misses 2 / (2 + b) in 2D, 1 /
// (1 + b) in a thread in 3D.
//
// Walls and obstacles hold what touches them, or have no shear. Where a face of a difference is in
// an obstacle, the difference is that to the surface over the part theta of the way to it; half of
// it at walls, on which the velocity across is given.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/grid/sides.h"
#include "substep/gridfluid/particles/transfer_to_grid.h"
#include "substep/gridfluid/pressure/obstacles.h"
#include "substep/gridfluid/pressure/projection.h"
#include "substep/gridfluid/viscosity/velocity_system.h"
#include "substep/gridfluid/viscosity/volumes.h"

namespace substep::gridfluid {

template <class Real, int D>
class Viscosity {
 public:
  Viscosity(const Layout<D>& layout, const OpenSides<D>& open, bool slip);

  struct Face {
    std::size_t axis;
    std::int64_t index;
  };
  std::vector<Face> held;  // that keep the velocities that they have

  // phi: of the liquid at the middle of cells, in cells, with ghosts. known: above 0 at faces whose
  // velocities are those of liquid; others have no mass. mass: of a full cell [kg]. tolerance: the
  // energy of the error over that of the velocities is its square. Obstacles that yield do.
  ViscosityReport apply(Obstacles<Real, D>& obstacles, std::span<const Real> phi,
                        const ConstFaces<Real, D>& known, double k, double mass,
                        Velocity<Real, D> u, double tolerance, int max_iterations, int threads);
  // Adds the pressure that goes with the divergence, times dt / (density dx), to q of fluid cells.
  void add_pressure(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u,
                    std::span<const Cell> cells, std::span<double> q, int threads) const;
  // Makes known above 0 at faces to which the last call gave velocities.
  void mark(const Faces<Real, D>& known) const;
  // What the last call gave to colliders; mass: of a full cell [kg].
  std::vector<geometry::Exchange> exchanges(const Obstacles<Real, D>& obstacles, double mass) const;

 private:
  // Instead of a row: without liquid; held by an obstacle, by a wall, or as it is.
  static constexpr std::int32_t kNone = -1, kObstacle = -2, kWall = -3, kHeld = -4;
  using Place = std::array<int, D>;
  static constexpr std::size_t kAll = D;  // as second axis of a rate of strain: the divergence
  // What a rate of strain is made of: coefficient times velocity of a face, and a given number.
  struct Term {
    std::size_t axis;
    std::int64_t face;
    std::int32_t row;  // of the system
    double coefficient, given;
    // Of an obstacle: the part of what is given that is its velocity at the face of the other term.
    double inner = 0;
    double covered = 0;  // times the velocity of an obstacle at the face comes to it
  };
  struct Strain {
    double weight;  // 0: there is none
    double given = 0;
    int count = 0;
    std::array<Term, 2 * D> terms;
  };
  // What an obstacle got at a face in it, in masses of a full cell [m/s].
  struct Pull {
    std::size_t axis;
    std::int64_t face;
    double impulse;
  };

  // What an obstacle that yields gives to rates of strain: coefficient times its velocity at a
  // face.
  struct Held {
    std::size_t axis;
    std::int64_t face;
    double coefficient;
  };
  using Motion = typename BodyOfRows<D>::Motion;
  using Mobility = typename BodyOfRows<D>::Mobility;
  using Motions = std::vector<std::pair<std::size_t, Motion>>;  // by the number in yielding_
  struct Yields {                                               // a collider
    std::size_t collider, body;                                 // the number of system_.bodies
    Motion push = Motion::Zero();                               // on it, in masses of a full cell
  };

  std::vector<Held> held_in(const Strain& strain) const;
  void find_yielding(const Obstacles<Real, D>& obstacles);
  template <class Use>
  void for_pushes(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u, const Use& use);
  void add_bodies(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u, double mass);
  void move_bodies(Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u, int threads);
  void hold(const Obstacles<Real, D>& obstacles, Velocity<Real, D> u);
  void find_pulls(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u);
  void find_rows(const Obstacles<Real, D>& obstacles, std::span<const Real> phi, int threads);
  void order_rows(std::size_t axis, const std::vector<std::int64_t>& faces);
  void find_matrix(const Obstacles<Real, D>& obstacles, const ConstFaces<Real, D>& known,
                   const Velocity<Real, D>& u, int threads);
  void find_row(const Obstacles<Real, D>& obstacles, const ConstFaces<Real, D>& known,
                const Velocity<Real, D>& u, std::int64_t row);
  static double theirs(const Obstacles<Real, D>& obstacles, std::size_t axis, std::int64_t face);
  std::int32_t holder(const Obstacles<Real, D>& obstacles, std::size_t axis, std::int64_t face,
                      const Place& place) const;
  bool moves(std::size_t axis, std::int64_t face, const Place& place) const;
  template <class Use>
  void for_strains(std::size_t axis, const Place& face, const Use& use) const;
  Strain strain(const Obstacles<Real, D>& obstacles, std::size_t a, std::size_t b,
                const Place& place) const;
  Strain divergence(const Obstacles<Real, D>& obstacles, const Place& cell) const;
  double pressure(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u,
                  const Place& cell) const;
  double pressed(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u, std::size_t axis,
                 const Place& face) const;
  double rounded(double weight) const;
  double rate(const Strain& strain, const Velocity<Real, D>& u) const;
  bool add_difference(const Obstacles<Real, D>& obstacles, std::size_t component, std::size_t along,
                      const Place& upper, Strain& strain) const;
  double volume(std::size_t a, std::size_t b, std::int64_t i) const;

  Layout<D> layout_;
  OpenSides<D> open_;
  bool slip_;
  double k_ = 0;
  Volumes<Real, D> volumes_;
  std::array<std::vector<std::int32_t>, D> row_;  // of each face, or what it is instead
  std::vector<std::int64_t> face_;                // of each row
  VelocitySystem<D> system_;
  std::vector<double> b_, x_, energy_;
  std::vector<Pull> pulls_;
  std::vector<Yields> yielding_;
};

// use(a, b, place) for the rates of strain that a face is in: in cells where a = b, and at edges.
template <class Real, int D>
template <class Use>
void Viscosity<Real, D>::for_strains(std::size_t axis, const Place& face, const Use& use) const {
  for (int end = 0; end < 2; ++end) {
    Place cell = face;
    cell[axis] -= 1 - end;
    if (layout_.periodic[axis] && cell[axis] < 0) cell[axis] += layout_.cells[axis];
    if (cell[axis] >= 0 && cell[axis] < layout_.cells[axis]) {
      use(axis, axis, cell);
      use(axis, kAll, cell);
    }
    for (std::size_t b = 0; b < D; ++b) {
      if (b == axis) continue;
      Place edge = face;
      edge[b] += end;
      if (layout_.periodic[b] && edge[b] == layout_.cells[b]) edge[b] = 0;
      use(axis, b, edge);
    }
  }
}

extern template class Viscosity<float, 2>;
extern template class Viscosity<float, 3>;
extern template class Viscosity<double, 2>;
extern template class Viscosity<double, 3>;

}  // namespace substep::gridfluid
