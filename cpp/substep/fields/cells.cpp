#include "substep/fields/cells.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::fields {
namespace {

double cross(const Vec2& a, const Vec2& b) { return a[0] * b[1] - a[1] * b[0]; }
double dot(const Vec2& a, const Vec2& b) { return a[0] * b[0] + a[1] * b[1]; }
Vec2 along(const Vec2& a, double s, const Vec2& b) { return {a[0] + s * b[0], a[1] + s * b[1]}; }
Vec2 operator-(const Vec2& a, const Vec2& b) { return {a[0] - b[0], a[1] - b[1]}; }

// By how much s is outside of [0, 1].
double outside(double s) { return std::max(-s, s - 1); }

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kMargin = 1e-3;  // of a box around a cell, more than any slack
constexpr double kInside = 1e-3;  // of a cell, from its sides: nothing else holds what is there

}  // namespace

Cells::Cells(Corners corners, double period)
    : corners_(std::move(corners)), period_(period), inverse_period_(period > 0 ? 1 / period : 0) {
  const std::int64_t most = std::numeric_limits<std::int32_t>::max();
  if (corners_.rows * corners_.columns > most)
    throw InputError("x, y: expected below 2^31 corners");
  kind_.assign(usize((corners_.rows - 1) * (corners_.columns - 1)), kNone);
  // From boxes below it, of which there are so many, or from cells.
  const auto add_layer = [&](std::int64_t rows, std::int64_t columns, const auto& below) {
    Layer layer{(rows + 1) / 2, (columns + 1) / 2, {}};
    layer.boxes.assign(usize(layer.rows * layer.columns),
                       {{kInfinity, kInfinity}, {-kInfinity, -kInfinity}});
    for (std::int64_t i = 0; i < rows; ++i) {
      poll_interrupt();
      for (std::int64_t j = 0; j < columns; ++j) {
        include(layer.boxes[usize(i / 2 * layer.columns + j / 2)], below(i, j));
      }
    }
    layers_.push_back(std::move(layer));
  };
  add_layer(corners_.rows - 1, corners_.columns - 1, [&](std::int64_t i, std::int64_t j) {
    const Box box = box_of_cell(i, j);
    kind_[usize(i * (corners_.columns - 1) + j)] = box.low[0] <= box.high[0] ? kCell : kNone;
    return box;
  });
  while (layers_.back().boxes.size() > 1) {
    const Layer last = layers_.back();
    add_layer(last.rows, last.columns, [&](std::int64_t i, std::int64_t j) {
      return last.boxes[usize(i * last.columns + j)];
    });
  }
  const Box& all = layers_.back().boxes[0];
  if (!(all.low[0] <= all.high[0])) {
    throw InputError("x, y: expected cells whose corners turn one way, got none");
  }
  // Grids of ocean models have rows twice, and cells may lie upon each other.
  std::vector<std::uint8_t> kind = kind_;
  parallel_for(static_cast<std::int64_t>(kind.size()), 4096,
               [&](std::int64_t begin, std::int64_t end) {
                 for (std::int64_t cell = begin; cell < end; ++cell) {
                   if (kind[usize(cell)] == kCell && is_first(cell)) kind[usize(cell)] = kFirst;
                 }
               });
  kind_.swap(kind);
}

// Whether the search finds this cell for points well inside of it.
bool Cells::is_first(std::int64_t cell) const {
  const std::int64_t i = cell / (corners_.columns - 1), j = cell % (corners_.columns - 1);
  const auto k = usize(i * corners_.columns + j);
  const Vec2 x{corners_.x[k], corners_.y[k]};
  const Quad q = quad(i, j, x);
  constexpr double kLow = 0.02, kHigh = 0.98;
  for (const auto& [xi, eta] :
       {Vec2{0.5, 0.5}, {kLow, kLow}, {kHigh, kLow}, {kLow, kHigh}, {kHigh, kHigh}}) {
    std::int64_t found = -1;
    locate(along(along(along(x, xi, q.b), eta, q.c), xi * eta, q.d), 0, found);
    if (found != cell) return false;
  }
  return true;
}

double Cells::reduced(double dx) const {
  return dx - period_ * std::nearbyint(dx * inverse_period_);
}

Vec2 Cells::corner(std::int64_t i, std::int64_t j, double near) const {
  const auto k = usize(i * corners_.columns + j);
  return {near + reduced(corners_.x[k] - near), corners_.y[k]};
}

auto Cells::quad(std::int64_t i, std::int64_t j, const Vec2& x) const -> Quad {
  const auto k = usize(i * corners_.columns + j), above = k + usize(corners_.columns);
  const std::vector<double>&u = corners_.x, &v = corners_.y;
  const Vec2 b{reduced(u[above] - u[k]), v[above] - v[k]},
      c{reduced(u[k + 1] - u[k]), v[k + 1] - v[k]},
      diagonal{reduced(u[above + 1] - u[k]), v[above + 1] - v[k]};
  return {{reduced(u[k] - x[0]), v[k] - x[1]}, b, c, diagonal - b - c};
}

bool Cells::turns_one_way(const Quad& q) const {
  const Vec2 right = along(q.b, 1, q.d), ahead = along(q.c, 1, q.d);
  // The pole is inside where the sides do not come back to where they began.
  if (period_ > 0 && std::max(std::abs(ahead[0]), std::abs(right[0])) >= 0.5 * period_) {
    return false;
  }
  const double turns[4] = {cross(q.b, q.c), cross(q.b, ahead), cross(right, ahead),
                           cross(right, q.c)};
  if (!std::isfinite(turns[0] + turns[1] + turns[2] + turns[3])) return false;
  const auto [least, most] = std::minmax_element(turns, turns + 4);
  return (*least >= 0 && *most > 0) || (*most <= 0 && *least < 0);
}

auto Cells::box_of_cell(std::int64_t i, std::int64_t j) const -> Box {
  Box box{{kInfinity, kInfinity}, {-kInfinity, -kInfinity}};
  const auto k = usize(i * corners_.columns + j);
  const Vec2 x{corners_.x[k], corners_.y[k]};
  const Quad q = quad(i, j, x);
  if (!turns_one_way(q)) return box;
  for (const Vec2& side : {Vec2{}, q.b, q.c, along(along(q.b, 1, q.c), 1, q.d)}) {
    for (int d = 0; d < 2; ++d) {
      box.low[d] = std::min(box.low[d], x[d] + side[d]);
      box.high[d] = std::max(box.high[d], x[d] + side[d]);
    }
  }
  for (int d = 0; d < 2; ++d) {
    const double margin = kMargin * (box.high[d] - box.low[d]);
    box.low[d] -= margin;
    box.high[d] += margin;
  }
  const double turns = period_ * std::floor(box.low[0] * inverse_period_);
  box.low[0] -= turns;
  box.high[0] -= turns;
  return box;
}

void Cells::include(Box& box, const Box& other) const {
  if (!(other.low[0] <= other.high[0])) return;
  if (!(box.low[0] <= box.high[0])) {
    box = other;
    return;
  }
  // The other one where it is nearest to the first.
  const double middle = 0.5 * (other.low[0] + other.high[0] - box.low[0] - box.high[0]);
  const double shift = reduced(middle) - middle;
  box.low = {std::min(box.low[0], other.low[0] + shift), std::min(box.low[1], other.low[1])};
  box.high = {std::max(box.high[0], other.high[0] + shift), std::max(box.high[1], other.high[1])};
  const double turns = period_ * std::floor(box.low[0] * inverse_period_);
  box.low[0] -= turns;
  box.high[0] -= turns;
}

// Where x[0] is in [0, period).
bool Cells::holds(const Box& box, const Vec2& x) const {
  if (x[1] < box.low[1] || x[1] > box.high[1]) return false;
  return (x[0] >= box.low[0] && x[0] <= box.high[0]) ||
         (period_ > 0 && x[0] + period_ <= box.high[0]);
}

bool Cells::find_in(std::int64_t i, std::int64_t j, const Vec2& x, double slack,
                    Location& out) const {
  if (kind_[usize(i * (corners_.columns - 1) + j)] == kNone) return false;
  const Quad q = quad(i, j, x);
  const double square = cross(q.c, q.d), linear = cross(q.c, q.b) + cross(q.a, q.d),
               constant = cross(q.a, q.b);
  const double inside = linear * linear - 4 * square * constant;
  if (inside < 0) return false;
  // Both roots without cancellation; that of a parallelogram, whose `square` is 0, is the first.
  const double half = -0.5 * (linear + std::copysign(std::sqrt(inside), linear));
  for (const double eta : {constant / half, half / square}) {
    if (!(outside(eta) <= slack)) continue;
    const Vec2 by_xi = along(q.b, eta, q.d);
    const double xi = -dot(along(q.a, eta, q.c), by_xi) / dot(by_xi, by_xi);
    if (!(outside(xi) <= slack)) continue;
    out = {i, j, {xi, eta}, by_xi, along(q.c, xi, q.d)};
    return true;
  }
  return false;
}

auto Cells::locate(const Vec2& point, double slack, std::int64_t& hint) const -> Location {
  Location found;
  if (!std::isfinite(point[0] + point[1])) return found;
  const Vec2 x{point[0] - period_ * std::floor(point[0] * inverse_period_), point[1]};
  const std::int64_t across = corners_.columns - 1;
  if (hint >= 0 && kind_[usize(hint)] == kFirst &&
      find_in(hint / across, hint % across, x, -kInside, found)) {
    return found;
  }
  hint = -1;
  struct Open {
    std::size_t layer;
    std::int64_t i, j;
  };
  std::array<Open, 3 * 32 + 1> open;  // three of the four wait in each layer
  std::size_t count = 0;
  open[count++] = {layers_.size() - 1, 0, 0};
  while (count > 0) {
    const auto [l, i, j] = open[--count];
    const Layer& layer = layers_[l];
    if (!holds(layer.boxes[usize(i * layer.columns + j)], x)) continue;
    const std::int64_t rows = l > 0 ? layers_[l - 1].rows : corners_.rows - 1,
                       columns = l > 0 ? layers_[l - 1].columns : corners_.columns - 1;
    const std::int64_t last_i = std::min(2 * i + 1, rows - 1),
                       last_j = std::min(2 * j + 1, columns - 1);
    if (l == 0) {
      for (std::int64_t a = 2 * i; a <= last_i; ++a) {
        for (std::int64_t b = 2 * j; b <= last_j; ++b) {
          if (!find_in(a, b, x, slack, found)) continue;
          hint = a * across + b;
          return found;
        }
      }
      continue;
    }
    for (std::int64_t a = last_i; a >= 2 * i; --a) {
      for (std::int64_t b = last_j; b >= 2 * j; --b) open[count++] = {l - 1, a, b};
    }
  }
  return found;
}

}  // namespace substep::fields
