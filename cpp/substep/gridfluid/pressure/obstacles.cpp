#include "substep/gridfluid/pressure/obstacles.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {
namespace {

using geometry::Collider;
using geometry::Exchange;

constexpr double kBand = 2;       // cells around the surface where distances are exact
constexpr int kPose = 7;          // numbers of a collider's state that say where it is
constexpr double kClosed = 1e-3;  // a face that is less open is closed

// The part above 0 of an edge that ends in a <= 0 < b.
template <class Real>
Real above(Real a, Real b) {
  return b / (b - a);
}

// The part of a face where the distance, linear along its edges, is above 0.
template <class Real>
Real open_part(const std::array<Real, 2>& d) {
  const bool in0 = d[0] <= 0, in1 = d[1] <= 0;
  if (in0 != in1) return in0 ? above(d[0], d[1]) : above(d[1], d[0]);
  return Real(in0 ? 0 : 1);
}
// Of a square with corners in a circle.
template <class Real>
Real open_part(const std::array<Real, 4>& d) {
  const auto in = [&](std::size_t k) { return d[k % 4] <= 0; };
  const auto part = [&](std::size_t from, std::size_t to) { return above(d[from % 4], d[to % 4]); };
  const auto solid_corner = [&](std::size_t k) {  // a triangle
    return (1 - part(k, k + 1)) * (1 - part(k, k + 3)) / 2;
  };
  const auto open_corner = [&](std::size_t k) { return part(k + 1, k) * part(k + 3, k) / 2; };
  const int solid = in(0) + in(1) + in(2) + in(3);
  if (solid == 0) return 1;
  if (solid == 4) return 0;
  std::size_t k = 0;
  if (solid == 1) {
    while (!in(k)) ++k;
    return 1 - solid_corner(k);
  }
  if (solid == 3) {
    while (in(k)) ++k;
    return open_corner(k);
  }
  while (!in(k)) ++k;
  if (in(k + 2)) {  // two opposite corners: joined by what the middle is
    return d[0] + d[1] + d[2] + d[3] > 0 ? 1 - solid_corner(k) - solid_corner(k + 2)
                                         : open_corner(k + 1) + open_corner(k + 3);
  }
  if (!in(k + 1)) k += 3;  // now k and k + 1 are solid
  return (part(k, k + 3) + part(k + 1, k + 2)) / 2;
}

}  // namespace

template <class Real, int D>
Obstacles<Real, D>::Obstacles(const Layout<D>& layout, const Vec3& low_, double dx_,
                              std::vector<Collider> obstacles)
    : colliders(std::move(obstacles)), low(low_), dx(dx_), layout_(layout) {}

template <class Real, int D>
void Obstacles<Real, D>::find(int threads) {
  if (!any()) return;
  std::vector<std::array<double, Collider::kStateSize>> states;
  moving_ = false;
  bool yield = false;
  for (const Collider& c : colliders) {
    states.push_back(c.state());
    yield |= c.yields();
    moving_ |= !c.velocity.isZero(0) || !c.angular_velocity.isZero(0);
  }
  if (found_ && states == states_ && (know_near_ || !yield)) return;
  const auto in_place = [](const auto& was, const auto& is) {
    return std::equal(is.begin(), is.begin() + kPose, was.begin());
  };
  const bool placed =
      found_ && std::equal(states.begin(), states.end(), states_.begin(), states_.end(), in_place);
  found_ = false;
  if (!placed) {
    find_distances(threads);
    find_open(threads);
    find_room(threads);
    know_near_ = false;
  }
  if ((moving_ || yield) && !know_near_) {
    find_faces_near(threads);
    if (yield) refine_open(threads);
  }
  if (moving_) find_velocities(threads);
  states_ = std::move(states);
  found_ = true;
}

// Of a point in cells.
template <class Real, int D>
Vec3 Obstacles<Real, D>::world(const std::array<double, D>& x) const {
  Vec3 at = low;
  for (std::size_t a = 0; a < D; ++a) at[static_cast<int>(a)] += dx * x[a];
  return at;
}

template <class Real, int D>
Vec3 Obstacles<Real, D>::middle(std::int64_t i, int faces_of) const {
  const std::array<int, D> cell = layout_.cell(i);
  std::array<double, D> x;
  for (std::size_t a = 0; a < D; ++a) x[a] = cell[a] + (static_cast<int>(a) == faces_of ? 0 : 0.5);
  return world(x);
}

template <class Real, int D>
std::size_t Obstacles<Real, D>::nearest(const Vec3& x) const {
  return nearest_of(all_, x);
}

template <class Real, int D>
std::size_t Obstacles<Real, D>::nearest_of(const Numbers& which, const Vec3& x) const {
  if (which.size() == 1) return which[0];
  std::size_t found = 0;
  double least = std::numeric_limits<double>::infinity();
  for (const std::size_t c : which) {
    const double d = colliders[c].signed_distance(x).value;
    if (d < least) least = d, found = c;
  }
  return found;
}

template <class Real, int D>
double Obstacles<Real, D>::signed_distance(const Numbers& which, const Vec3& x) const {
  double least = std::numeric_limits<double>::infinity();
  for (const std::size_t c : which) least = std::min(least, colliders[c].signed_distance(x).value);
  return least;
}

// Those that may be nearest to what is beside a node, its cell and the faces of that among it.
template <class Real, int D>
auto Obstacles<Real, D>::near_block(const std::array<int, D>& node) const -> const Numbers& {
  std::size_t b = 0;
  for (std::size_t a = 0; a < D; ++a) b = b * usize(blocks_[a]) + usize(node[a] / kBlock);
  return of_block_[b].empty() ? all_ : of_block_[b];
}

// In blocks of nodes: where the middle is far from all surfaces, all of a block is.
template <class Real, int D>
void Obstacles<Real, D>::find_distances(int threads) {
  if (distance_.size() == 0) assign(distance_, layout_.size, Real(0));
  double lipschitz = 1;
  for (const Collider& c : colliders) lipschitz = std::max(lipschitz, c.lipschitz());
  const double radius = std::sqrt(D) * (kBlock - 1) / 2 * lipschitz;
  const double reach = std::sqrt(D) * (kBlock + 1) / 2 * lipschitz;  // of cells that begin in it
  std::int64_t count = 1;
  for (std::size_t a = 0; a < D; ++a) {
    blocks_[a] = layout_.cells[a] / kBlock + 1;
    count *= blocks_[a];
  }
  all_.resize(colliders.size());
  std::iota(all_.begin(), all_.end(), std::size_t{0});
  of_block_.resize(usize(count));
  parallel_for(
      count, 32,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<double> distances(colliders.size());
        for (std::int64_t b = begin; b < end; ++b) {
          std::array<int, D> from, to;
          std::array<double, D> middle;
          std::int64_t rest = b;
          for (std::size_t a = D; a-- > 0;) {
            from[a] = static_cast<int>(rest % blocks_[a]) * kBlock;
            to[a] = std::min(from[a] + kBlock, layout_.cells[a] + 1);
            middle[a] = from[a] + (kBlock - 1) / 2.0;
            rest /= blocks_[a];
          }
          const Vec3 at = world(middle);
          for (std::size_t c = 0; c < colliders.size(); ++c)
            distances[c] = colliders[c].signed_distance(at).value;
          const double least = *std::min_element(distances.begin(), distances.end());
          const double there = least / dx;
          const bool far = std::abs(there) > radius + kBand;
          Numbers& near = of_block_[usize(b)];
          near.clear();
          for (std::size_t c = 0; c < colliders.size() && !far; ++c)
            if (distances[c] <= least + 2 * reach * dx) near.push_back(c);
          std::array<int, D> node = from;
          do {
            std::array<double, D> x;
            std::copy(node.begin(), node.end(), x.begin());
            distance_[usize(layout_.index(node))] =
                Real(far ? there : signed_distance(near, world(x)) / dx);
          } while (next_in_block(node, from, to));
        }
      },
      threads);
}

template <class Real, int D>
void Obstacles<Real, D>::find_open(int threads) {
  const std::array<std::int64_t, D>& s = layout_.stride;
  for (std::size_t a = 0; a < D; ++a) {
    if (open_[a].size() == 0) {
      assign(open_[a], layout_.size, Real(1));
    }
    const std::int64_t b = s[(a + 1) % D], c = D == 3 ? s[(a + 2) % D] : 0;
    const auto part = [&](std::int64_t i) {
      Real whole;
      if constexpr (D == 2) {
        whole = open_part(std::array{distance_[usize(i)], distance_[usize(i + b)]});
      } else {
        whole = open_part(std::array{distance_[usize(i)], distance_[usize(i + b)],
                                     distance_[usize(i + b + c)], distance_[usize(i + c)]});
      }
      return whole < Real(kClosed) ? Real(0) : whole;
    };
    for_rows(layout_, all_faces(layout_, a), threads, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) open_[a][usize(i)] = part(i);
    });
  }
}

template <class Real, int D>
void Obstacles<Real, D>::find_faces_near(int threads) {
  know_near_ = false;
  using Faces = std::vector<Face>;
  for (std::size_t a = 0; a < D; ++a) {
    near_[a] = gather_rows(
        layout_, all_faces(layout_, a), threads, Faces{},
        [&](std::int64_t begin, std::int64_t end) {
          Faces found;
          for (std::int64_t i = begin; i < end; ++i) {
            if (std::abs(distance_[usize(i)]) > Real(kBand)) continue;
            const Vec3 at = middle(i, static_cast<int>(a));
            found.push_back({i, nearest_of(near_block(layout_.cell(i)), at)});
          }
          return found;
        },
        [](Faces& all, const Faces& part) { all.insert(all.end(), part.begin(), part.end()); });
    assign(velocity_[a], layout_.size, Real(0));
  }
  know_near_ = true;
}

// The faces that bodies cut, in parts: else a ball of 12 cells would displace 1 % too little, more
// than what many a body weighs less than the fluid.
template <class Real, int D>
void Obstacles<Real, D>::refine_open(int threads) {
  constexpr int kParts = 2;           // along an axis
  constexpr Real kBulge = Real(0.2);  // of a surface that passes between the corners of a face
  const std::array<std::int64_t, D>& s = layout_.stride;
  const auto refine = [&](std::size_t a, const Face& face) {
    std::array<std::size_t, D - 1> across;  // the other axes
    for (std::size_t k = 0; k < D - 1; ++k) across[k] = (a + 1 + k) % D;
    bool in = false, out = false;
    for (std::size_t corner = 0; corner < 1 << (D - 1); ++corner) {
      std::int64_t i = face.index;
      for (std::size_t k = 0; k < D - 1; ++k) i += (corner >> k & 1) * s[across[k]];
      in |= distance_[usize(i)] < kBulge;
      out |= distance_[usize(i)] > -kBulge;
    }
    if (!in || !out) return;
    const std::array<int, D> cell = layout_.cell(face.index);
    const Numbers& near = near_block(cell);
    const auto distance_at = [&](int j, int k) {  // of a corner of a part
      std::array<double, D> x;
      for (std::size_t b = 0; b < D; ++b) x[b] = cell[b];
      x[across[0]] += double(j) / kParts;
      if constexpr (D == 3) x[across[1]] += double(k) / kParts;
      return Real(signed_distance(near, world(x)) / dx);
    };
    Real sum = 0;
    std::array<std::array<Real, kParts + 1>, D == 2 ? 1 : kParts + 1> d;
    for (std::size_t k = 0; k < d.size(); ++k)
      for (int j = 0; j <= kParts; ++j) d[k][usize(j)] = distance_at(j, static_cast<int>(k));
    for (std::size_t j = 0; j < kParts; ++j) {
      if constexpr (D == 2) {
        sum += open_part(std::array{d[0][j], d[0][j + 1]}) / kParts;
      } else {
        for (std::size_t k = 0; k < kParts; ++k)
          sum += open_part(std::array{d[k][j], d[k][j + 1], d[k + 1][j + 1], d[k + 1][j]}) /
                 (kParts * kParts);
      }
    }
    Real& open = open_[a][usize(face.index)];
    sum += (sum - open) / (kParts * kParts - 1);  // Richardson's
    open = sum < Real(kClosed) ? Real(0) : std::min(sum, Real(1));
  };
  for (std::size_t a = 0; a < D; ++a) {
    for_numbers(
        static_cast<std::int64_t>(near_[a].size()), threads,
        [&](std::size_t k) {
          if (colliders[near_[a][k].collider].yields()) refine(a, near_[a][k]);
        },
        64);
  }
}

template <class Real, int D>
void Obstacles<Real, D>::find_velocities(int threads) {
  for (std::size_t a = 0; a < D; ++a) {
    const int axis = static_cast<int>(a);
    for_numbers(static_cast<std::int64_t>(near_[a].size()), threads, [&](std::size_t k) {
      const auto [i, c] = near_[a][k];
      velocity_[a][usize(i)] = Real(colliders[c].surface_velocity(middle(i, axis))[axis]);
    });
  }
}

// The hat function over the open parts of cells: 1/8, 6/8, 1/8 along each axis. Sides are mirrors.
template <class Real, int D>
void Obstacles<Real, D>::find_room(int threads) {
  if (room_.size() == 0) assign(room_, layout_.size, Real(1));
  const auto open_volume = [&](std::int64_t i) {
    return std::clamp(at_centre(i) + Real(0.5), Real(0), Real(1));
  };
  for_rows(layout_, all_cells(layout_), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const Real distance = at_centre(i);
      if (std::abs(distance) > Real(kBand)) {
        room_[usize(i)] = distance > 0 ? Real(1) : Real(0);
        continue;
      }
      const std::array<int, D> cell = layout_.cell(i);
      std::array<int, D> from, to, next;
      for (std::size_t a = 0; a < D; ++a) from[a] = cell[a] - 1, to[a] = cell[a] + 2;
      Real sum = 0;
      next = from;
      do {
        Real weight = 1;
        std::array<int, D> at;
        for (std::size_t a = 0; a < D; ++a) {
          weight *= next[a] == cell[a] ? Real(0.75) : Real(0.125);
          at[a] = std::clamp(next[a], 0, layout_.cells[a] - 1);
        }
        sum += weight * open_volume(layout_.index(at));
      } while (next_in_block(next, from, to));
      room_[usize(i)] = sum;
    }
  });
}

template <class Real, int D>
Real Obstacles<Real, D>::at_centre(std::int64_t i) const {
  const std::array<std::int64_t, D>& s = layout_.stride;
  const auto edge = [&](std::int64_t j) { return distance_[usize(j)] + distance_[usize(j + 1)]; };
  if constexpr (D == 2) {
    return (edge(i) + edge(i + s[0])) / 4;
  } else {
    return (edge(i) + edge(i + s[0]) + edge(i + s[1]) + edge(i + s[0] + s[1])) / 8;
  }
}

template <class Real, int D>
Real Obstacles<Real, D>::at_face(std::int64_t i, std::size_t axis) const {
  const std::int64_t b = layout_.stride[(axis + 1) % D];
  const Real low = distance_[usize(i)] + distance_[usize(i + b)];
  if constexpr (D == 2) {
    return low / 2;
  } else {
    const std::int64_t c = i + layout_.stride[(axis + 2) % D];
    return (low + (distance_[usize(c)] + distance_[usize(c + b)])) / 4;
  }
}

// The faces and the surface close the part of a cell that is open: their normals add up to 0.
template <class Real, int D>
std::array<Real, D> Obstacles<Real, D>::surface(std::int64_t i) const {
  std::array<Real, D> area;
  for (std::size_t a = 0; a < D; ++a) {
    area[a] = open_[a][usize(i)] - open_[a][usize(i + layout_.stride[a])];
  }
  return area;
}

template <class Real, int D>
void Obstacles<Real, D>::push(std::span<const double> q, std::span<const Cell> cells, double mass,
                              int threads) {
  const auto yields = [](const Collider& c) { return c.yields(); };
  if (std::all_of(colliders.begin(), colliders.end(), yields)) return;
  const std::int64_t chunks = (layout_.rows() + kRowsOfTask - 1) / kRowsOfTask;
  std::vector<std::vector<Exchange>> parts(usize(chunks));
  parallel_for(
      layout_.rows(), kRowsOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<Exchange>& part = parts[usize(begin / kRowsOfTask)];
        part.resize(colliders.size());
        for (std::int64_t r = begin; r < end; ++r) {
          const std::int64_t row = layout_.row(r);
          for (std::int64_t i = row; i < row + layout_.row_length(); ++i) {
            if (cells[usize(i)] != Cell::kFluid) continue;
            const std::array<Real, D> area = surface(i);
            Vec3 impulse = Vec3::Zero();
            for (std::size_t a = 0; a < D; ++a) {
              impulse[static_cast<int>(a)] = mass * q[usize(i)] * double(area[a]);
            }
            if (impulse.isZero(0)) continue;
            const Vec3 at = middle(i);
            const std::size_t c = nearest_of(near_block(layout_.cell(i)), at);
            if (colliders[c].yields()) continue;  // see Bodies
            const geometry::SignedDistance d = colliders[c].signed_distance(at);
            part[c].add(at - d.value * d.gradient - colliders[c].position(), impulse);
          }
        }
      },
      threads);
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    Exchange sum;
    for (const std::vector<Exchange>& part : parts) sum += part[c];
    if (!yields(colliders[c])) colliders[c].set_exchange(sum);
  }
}

template class Obstacles<float, 2>;
template class Obstacles<float, 3>;
template class Obstacles<double, 2>;
template class Obstacles<double, 3>;

}  // namespace substep::gridfluid
