#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/pressure/obstacles.h"
#include "substep/gridfluid/pressure/open_halves.h"
#include "substep/gridfluid/pressure/open_part.h"

namespace substep::gridfluid {
namespace {

using geometry::Collider;

constexpr double kClosed = 1e-3;  // a face that is less open is closed
// Where the slope of the distance changes by more from one cell to the next an edge of an obstacle
// is near, or what is as sharp: it is looked at in parts, at most so often, while the distance in
// the middle of a part differs by more from the mean of its corners, in widths.
constexpr double kSharp = 0.4, kBent = 0.02;
constexpr int kDepth = 2;
constexpr double kAway = 1.8;                     // [cells]: of a node whose cell no surface is in
constexpr double kBulge = 0.2, kStraight = 1e-3;  // [cells], of a surface between corners

// Whether the surface passes between corners with these distances, or bulges in between them.
template <class Real, std::size_t kCorners>
bool is_cut(const std::array<Real, kCorners>& d, Real bulge = 0) {
  return std::any_of(d.begin(), d.end(), [&](Real distance) { return distance <= bulge; }) &&
         std::any_of(d.begin(), d.end(), [&](Real distance) { return distance > -bulge; });
}

// Of the corners of a block, with those upper along an axis by bits: those of its face, in a
// circle.
template <std::size_t D, class Real, std::size_t kCorners>
auto on_face(const std::array<Real, kCorners>& d, std::size_t a, std::size_t side) {
  const std::size_t b = std::size_t{1} << (a + 1) % D, from = side << a;
  if constexpr (D == 2) {
    return std::array{d[from], d[from + b]};
  } else {
    const std::size_t c = std::size_t{1} << (a + 2) % D;
    return std::array{d[from], d[from + b], d[from + b + c], d[from + c]};
  }
}

// The open part of a block that spans so many axes, by the distances of its corners.
template <class Real>
Real open_part_of(const std::array<Real, 2>& d) {
  return open_part(d);
}
template <class Real>
Real open_part_of(const std::array<Real, 4>& d) {
  return open_part(std::array{d[0], d[1], d[3], d[2]});
}
template <class Real>
Real open_part_of(const std::array<Real, 8>& d) {
  const std::array<Real, 2> halves = open_halves(on_face<3>(d, 0, 0), on_face<3>(d, 0, 1));
  return halves[0] + halves[1];
}

// The mean of the distances at the corners of a block from a point, less that in its middle.
template <std::size_t kAxes, class Real, std::size_t kCorners, class Distance>
Real bend(const std::array<Real, kCorners>& d, std::array<double, kAxes> middle, double wide,
          const Distance& distance) {
  Real mean = 0;
  for (const Real one : d) mean += one / kCorners;
  for (double& x : middle) x += wide / 2;
  return mean - distance(middle);
}

// Distances at the corners of a cell or a face, such that the flat surface between them leaves as
// much open as a round one does: in the mean over places and directions of that, it is further in
// by 3/4 of what the distance in the middle is less than between the corners. (2/3 for a distance
// that is parabolic, and up to 5/6 as flat surfaces have straight edges.)
template <std::size_t kAxes, class Real, std::size_t kCorners, class Distance>
std::array<Real, kCorners> flattened(std::array<Real, kCorners> d, const Distance& distance) {
  const Real round = bend(d, std::array<double, kAxes>{}, 1, distance);
  if (std::abs(round) > Real(kStraight))
    for (Real& one : d) one -= Real(0.75) * round;
  return d;
}

// The same in parts: parts[k] is that of the part upper along the axes of the bits of k, and 1 is
// all of it. distance(x) of a point, in the widths of the block.
template <std::size_t kAxes, class Real, std::size_t kCorners, class Distance>
std::array<Real, kCorners> open_parts(const std::array<Real, kCorners>& corners,
                                      const std::array<double, kAxes>& from, double wide, int depth,
                                      const Distance& distance) {
  constexpr std::array<std::size_t, 3> kThree{1, 3, 9};
  std::array<Real, kAxes == 1 ? 3 : kAxes == 2 ? 9 : 27> d;  // of the corners of the parts
  for (std::size_t n = 0; n < d.size(); ++n) {
    std::array<double, kAxes> x = from;
    std::size_t corner = 0;
    bool is = true;
    for (std::size_t a = 0; a < kAxes; ++a) {
      const std::size_t halves = n / kThree[a] % 3;
      x[a] += double(halves) * wide / 2;
      corner |= (halves / 2) << a;
      is = is && halves != 1;
    }
    d[n] = is ? corners[corner] : distance(x);
  }
  std::array<Real, kCorners> parts;
  for (std::size_t part = 0; part < kCorners; ++part) {
    std::array<double, kAxes> low = from;
    for (std::size_t a = 0; a < kAxes; ++a) low[a] += (part >> a & 1) * wide / 2;
    std::array<Real, kCorners> of_part;
    for (std::size_t corner = 0; corner < kCorners; ++corner) {
      std::size_t n = 0;
      for (std::size_t a = 0; a < kAxes; ++a)
        n += ((part >> a & 1) + (corner >> a & 1)) * kThree[a];
      of_part[corner] = d[n];
    }
    if (!is_cut(of_part)) {
      parts[part] = Real(of_part[0] > 0);
    } else if (depth == 1 ||
               std::abs(bend(of_part, low, wide / 2, distance)) <= Real(kBent * wide / 2)) {
      parts[part] = open_part_of(of_part);
    } else {
      parts[part] = 0;
      for (const Real of : open_parts(of_part, low, wide / 2, depth - 1, distance))
        parts[part] += of / kCorners;
    }
  }
  return parts;
}

}  // namespace

template <class Real, int D>
template <class Shape>
bool Obstacles<Real, D>::all_near(const std::array<int, D>& cell) const {
  const std::vector<NearCollider>& near = near_block(cell).all;
  return std::all_of(near.begin(), near.end(), [&](const NearCollider& one) {
    return std::holds_alternative<Shape>(colliders[one.collider].shape());
  });
}

template <class Real, int D>
bool Obstacles<Real, D>::all_balls(const std::array<int, D>& cell) const {
  const std::vector<NearCollider>& near = near_block(cell).all;
  return std::all_of(near.begin(), near.end(),
                     [&](const NearCollider& one) { return balls_[one.collider].sign != 0; });
}

// Whether the surface bulges between corners, where it has no edge, as a part of a smooth one. What
// several obstacles leave, or a hollow box in its corners, is bent too.
template <class Real, int D>
bool Obstacles<Real, D>::is_round(const std::array<int, D>& cell) const {
  const std::vector<NearCollider>& near = near_block(cell).all;
  const bool one =
      near.size() == 1 && !(all_near<geometry::Box>(cell) && colliders[near[0].collider].hollow());
  return one || all_balls(cell) || all_near<geometry::Triangle>(cell);
}

// Whether the distance is bent along one of the edges, along these axes, that the surface cuts of
// the block that begins in a cell and spans them. Balls have none, be they small.
template <class Real, int D>
template <std::size_t kAxes>
bool Obstacles<Real, D>::is_sharp(const std::array<int, D>& cell,
                                  const std::array<std::size_t, kAxes>& axes) const {
  if (all_balls(cell)) return false;
  const auto second = [&](std::int64_t i, std::int64_t s) {
    return std::abs(distance_[usize(i - s)] - 2 * distance_[usize(i)] + distance_[usize(i + s)]);
  };
  for (std::size_t corner = 0; corner < 1 << kAxes; ++corner) {
    std::int64_t i = layout_.index(cell);
    for (std::size_t k = 0; k < kAxes; ++k) i += (corner >> k & 1) * layout_.stride[axes[k]];
    for (std::size_t k = 0; k < kAxes; ++k) {
      const std::size_t a = axes[k];
      const std::int64_t s = layout_.stride[a];
      if (corner >> k & 1 || (distance_[usize(i)] <= 0) == (distance_[usize(i + s)] <= 0)) continue;
      const bool inner = cell[a] > 0 && cell[a] + 2 <= layout_.cells[a];
      if (!inner || std::max(second(i, s), second(i + s, s)) > Real(kSharp)) return true;
    }
  }
  return false;
}

template <class Real, int D>
void Obstacles<Real, D>::find_open(int threads) {
  constexpr std::size_t kCorners = 1 << (D - 1);
  const auto part = [&](std::size_t a, std::int64_t i, const std::array<int, D>& cell) {
    if (std::abs(distance_[usize(i)]) > Real(kAway)) return Real(distance_[usize(i)] > 0);
    std::array<std::size_t, D - 1> across;
    for (std::size_t k = 0; k < D - 1; ++k) across[k] = (a + 1 + k) % D;
    const std::array<Real, kCorners> d = at_corners(i, across);
    if (!is_cut(d) && !(is_cut(d, Real(kBulge)) && all_balls(cell))) return Real(d[0] > 0);
    const NearColliders& near = near_block(cell);
    const auto distance = [&](const std::array<double, D - 1>& x) {
      std::array<double, D> at;
      std::copy(cell.begin(), cell.end(), at.begin());
      for (std::size_t k = 0; k < D - 1; ++k) at[across[k]] += x[k];
      return distance_at(near, at);
    };
    Real whole = 0;
    if (is_sharp(cell, across)) {
      for (const Real one : open_parts(d, std::array<double, D - 1>{}, 1, kDepth, distance))
        whole += one / kCorners;
    } else {
      whole = open_part_of(is_round(cell) ? flattened<D - 1>(d, distance) : d);
    }
    return whole < Real(kClosed) ? Real(0) : whole;
  };
  for (std::size_t a = 0; a < D; ++a) {
    if (open_[a].size() == 0) assign(open_[a], layout_.size, Real(1));
    for_placed_rows(layout_, all_faces(layout_, a), threads,
                    [&](std::array<int, D> cell, std::int64_t begin, std::int64_t end) {
                      for (std::int64_t i = begin; i < end; ++i, ++cell[D - 1])
                        open_[a][usize(i)] = part(a, i, cell);
                    });
  }
}

template <class Real, int D>
auto Obstacles<Real, D>::cuts(int threads) -> std::span<const Cut> {
  if (know_cuts_) return cuts_;
  constexpr std::size_t kCorners = 1 << D;
  const std::array<std::int64_t, D>& s = layout_.stride;
  using Cuts = std::vector<Cut>;
  std::array<std::size_t, D> axes;
  std::iota(axes.begin(), axes.end(), std::size_t{0});
  const auto add = [&](std::int64_t i, const std::array<int, D>& cell, Cuts& cuts) {
    if (std::abs(distance_[usize(i)]) > Real(kAway)) return;
    const std::array<Real, kCorners> d = at_corners(i, axes);
    if (!is_cut(d, Real(kBulge)) || (!is_cut(d) && !all_balls(cell))) return;
    const NearColliders& near = near_block(cell);
    const auto distance = [&](const std::array<double, D>& x) {
      std::array<double, D> at;
      for (std::size_t a = 0; a < D; ++a) at[a] = cell[a] + x[a];
      return distance_at(near, at);
    };
    Cut cut{i, nearest_of(near, middle_of(cell, -1)), {}};
    if (is_sharp(cell, axes)) {
      const auto parts = open_parts(d, std::array<double, D>{}, 1, kDepth, distance);
      for (std::size_t a = 0; a < D; ++a)
        for (std::size_t part = 0; part < kCorners; ++part)
          cut.beside[a][part >> a & 1] += parts[part] / kCorners;
    } else {
      const std::array<Real, kCorners> e = is_round(cell) ? flattened<D>(d, distance) : d;
      for (std::size_t a = 0; a < D; ++a)
        cut.beside[a] = open_halves(on_face<D>(e, a, 0), on_face<D>(e, a, 1));
    }
    for (std::size_t a = 0; a < D; ++a)
      for (std::size_t side = 0; side < 2; ++side)
        cut.beside[a][side] -= open_[a][usize(i + (side == 1 ? s[a] : 0))] / 2;
    cuts.push_back(cut);
  };
  cuts_ = gather_rows(
      layout_, all_cells(layout_), threads, Cuts{},
      [&](std::int64_t begin, std::int64_t end) {
        Cuts found;
        std::array<int, D> cell = layout_.cell(begin);
        for (std::int64_t i = begin; i < end; ++i, ++cell[D - 1]) add(i, cell, found);
        return found;
      },
      [](Cuts& all, const Cuts& part) { all.insert(all.end(), part.begin(), part.end()); });
  know_cuts_ = true;
  return cuts_;
}

#define SUBSTEP_FIND_OPEN(Real, D)                  \
  template void Obstacles<Real, D>::find_open(int); \
  template auto Obstacles<Real, D>::cuts(int) -> std::span<const Cut>
SUBSTEP_FIND_OPEN(float, 2);
SUBSTEP_FIND_OPEN(float, 3);
SUBSTEP_FIND_OPEN(double, 2);
SUBSTEP_FIND_OPEN(double, 3);
#undef SUBSTEP_FIND_OPEN

}  // namespace substep::gridfluid
