// The cells of a curvilinear grid: quadrilaterals between corners (x, y), in which a point has the
// coordinates s = (xi, eta) in [0, 1]^2 of the bilinear map
//   x(s) = (1 - xi) (1 - eta) x_00 + xi (1 - eta) x_10 + (1 - xi) eta x_01 + xi eta x_11.
// With a = x_00 - x, b = x_10 - x_00, c = x_01 - x_00, d = x_00 - x_10 - x_01 + x_11 and the cross
// product of the plane, a + eta c = -xi (b + eta d) gives
//   (c x d) eta^2 + (c x b + a x d) eta + a x b = 0,   xi = -(a + eta c) . (b + eta d) / |b + eta
//   d|^2.
// Longitudes are taken relative to the point that is looked for, within 180 degrees: a cell across
// the date line is as any other, and a cell that has the pole inside is none.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace substep::fields {

using Vec2 = std::array<double, 2>;

// Corner (i, j) is number i columns + j; NaN where there is none.
struct Corners {
  std::int64_t rows = 0, columns = 0;
  std::vector<double> x, y;  // [m], or longitude and latitude [degrees]
};

// Where velocities are.
enum class Staggering { kCorners, kFaces };

class Cells {
 public:
  // period: of x, 0: none.
  Cells(Corners corners, double period);

  struct Location {
    std::int64_t i = -1, j = -1;  // of corner 00; -1: in no cell
    Vec2 s{};                     // xi, eta
    Vec2 by_xi{}, by_eta{};       // derivatives of x(s)
  };
  // Of the first cell that holds x; `slack`: how far s may lie outside of [0, 1]. `hint`: the
  // number of a cell to look into before, or -1; it gets that of the cell found. What is found is
  // the same.
  Location locate(const Vec2& x, double slack, std::int64_t& hint) const;

  const Corners& corners() const { return corners_; }
  // (x, y) of corner (i, j), x within half a period of `near`.
  Vec2 corner(std::int64_t i, std::int64_t j, double near) const;

 private:
  struct Quad {
    Vec2 a, b, c, d;
  };
  // The coordinates that cells have; low[0] is in [0, period).
  struct Box {
    Vec2 low, high;
  };
  Quad quad(std::int64_t i, std::int64_t j, const Vec2& x) const;  // relative to x
  bool turns_one_way(const Quad& quad) const;
  bool find_in(std::int64_t i, std::int64_t j, const Vec2& x, double slack, Location& out) const;
  Box box_of_cell(std::int64_t i, std::int64_t j) const;
  bool is_first(std::int64_t cell) const;
  void include(Box& box, const Box& other) const;
  bool holds(const Box& box, const Vec2& x) const;
  double reduced(double dx) const;  // to half a period

  Corners corners_;
  double period_, inverse_period_;
  // By row: none; one; one that is the first which holds what it has well inside.
  enum : std::uint8_t { kNone, kCell, kFirst };
  std::vector<std::uint8_t> kind_;
  // Boxes around 2 x 2 cells, around 2 x 2 of those, and so on up to one around all.
  struct Layer {
    std::int64_t rows, columns;
    std::vector<Box> boxes;
  };
  std::vector<Layer> layers_;
};

}  // namespace substep::fields
