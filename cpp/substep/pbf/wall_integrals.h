// What an obstacle adds to the density of a particle near it: the integral b of the kernel W over
// the obstacle, as if that were filled with the fluid at rest, and the gradient of b. Exact, up to
// tables, for half spaces, balls and boxes.
//
// A sphere of radius r about the particle lies in a ball of radius R, the surface of which is at
// distance d, with the share f of its area (of its angle where space has two dimensions):
//   D = R + d,   c = (D^2 + r^2 - R^2) / (2 D r),   f = (1 - c) / 2 in 3D, acos(c) / pi in 2D,
//   b(d) = integral_0^h W(r) S(r) f dr,   S = 4 pi r^2 in 3D, 2 pi r in 2D.
// A half space is the limit c = d / r.
//
// A box is a sum over its corners (inclusion and exclusion): with the coordinates x_0 < x_1 of its
// sides from the particle on, and y, z likewise,
//   b = sum_ijk (-1)^(i+j+k) O(x_i, y_j, z_k),   O(x, y, z) = the integral of W beyond x, y and z.
// As W is even, O(-x, y, z) = O(-inf, y, z) - O(x, y, z) and O(-inf, y, z) = 2 O(0, y, z), so a
// table of O on [0, h]^3 does. Where walls of a tank meet, nothing is counted twice.
#pragma once

#include <array>
#include <functional>
#include <vector>

#include "substep/geometry/vectors.h"

namespace substep::pbf {

using geometry::Vec3;
using KernelFunction = std::function<double(double)>;  // W(r)

struct WallDensity {
  double value = 0;              // b
  Vec3 gradient = Vec3::Zero();  // by the position of the particle
};

// b as a function of the distance d in [-h, h] from a half space or a ball.
class DistanceTable {
 public:
  // radius: of the ball; infinite for a half space.
  DistanceTable(const KernelFunction& kernel, double h, int dimension, double radius);

  struct Entry {
    double value, slope;  // b, db/dd
  };
  Entry operator()(double d) const;

 private:
  double h_;
  std::vector<Entry> entries_;
};

// A half space of liquid is layers of particles, not the continuum of b: beside a lattice that
// begins half a spacing l from a wall, b lacks or exceeds what further layers would add (with the
// cubic spline and h = 2 l, 0.188 for 0.150), and the lattice would burst. As mirrored particles do
// (Colagrossi and Landrini, J. Comput. Phys. 191, 2003) the layers beyond the wall follow the
// particle: with a(z) = -b'(z), the integral of W over the plane at distance z, and c near 1 such
// that m(l / 2) is the sum over a lattice,
//   m(s) = c l sum_k a(2 s + k l),   k = 0, 1, ...
// phi(s) is the distance at which b is m(s): obstacles of any form act as if they were there.
class Mirror {
 public:
  Mirror(const DistanceTable& plane, double h, double spacing, double half_lattice);

  struct Entry {
    double value, slope;       // m, dm/ds
    double distance, stretch;  // phi, dphi/ds
  };
  Entry operator()(double s) const;
  double reach() const { return reach_; }  // m is 0 from there on

 private:
  double reach_, h_;
  std::vector<Entry> entries_;
};

// Integrals over what lies beyond one, two or three perpendicular planes.
class CornerTable {
 public:
  CornerTable(const KernelFunction& kernel, double h, int dimension);

  // The integral over the box low <= x <= high, which are given from the particle on, and its
  // derivatives by them. In two dimensions z is ignored.
  struct BoxIntegral {
    double value = 0;
    Vec3 by_low = Vec3::Zero(), by_high = Vec3::Zero();
  };
  BoxIntegral box(const Vec3& low, const Vec3& high) const;

  // O and its derivatives for x, y, z >= 0.
  using Octant = std::array<double, 4>;
  Octant octant(const Vec3& from) const;

 private:
  struct Node {
    double value, by_x;  // derivatives by y and z are those of mirrored nodes
  };
  const Node& node(std::size_t i, std::size_t j, std::size_t k) const;

  double h_;
  int dimension_;
  std::vector<Node> nodes_;
};

}  // namespace substep::pbf
