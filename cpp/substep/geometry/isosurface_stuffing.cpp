#include "substep/geometry/isosurface_stuffing.h"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/mesh_sampling.h"

namespace substep::geometry {

namespace {

using Index = std::int64_t;

// Cut points nearer to a vertex than this part of the edge draw it onto the surface (section 3.3:
// "safe" values for which all dihedral angles lie between 10.7 and 164.8 degrees).
constexpr double kNearLong = 0.24999, kNearShort = 0.41189;

// A body-centred cubic lattice: cube corners (i, j, k), then cube centres (i, j, k) + 1/2. Each
// tetrahedron has two long edges (corner-corner, centre-centre) and four short ones.
class Lattice {
 public:
  Lattice(const TriangleTree& tree, double spacing, int threads) : spacing_(spacing) {
    for (int d = 0; d < 3; ++d)
      cubes_[usize(d)] =
          static_cast<Index>(std::ceil((tree.upper()[d] - tree.lower()[d]) / spacing)) + 3;
    const Vec3 extent(static_cast<double>(cubes_[0]), static_cast<double>(cubes_[1]),
                      static_cast<double>(cubes_[2]));
    origin_ = 0.5 * (tree.lower() + tree.upper()) - 0.5 * spacing * extent;
    corners_ = (cubes_[0] + 1) * (cubes_[1] + 1) * (cubes_[2] + 1);
    const Index centers = cubes_[0] * cubes_[1] * cubes_[2];
    distance.resize(usize(corners_ + centers));
    sample_signed_distance(tree, {cubes_[0] + 1, cubes_[1] + 1, cubes_[2] + 1}, origin_, spacing,
                           distance.data(), threads);
    sample_signed_distance(tree, cubes_, origin_ + Vec3::Constant(0.5 * spacing), spacing,
                           distance.data() + corners_, threads);
  }

  bool is_corner(Index v) const { return v < corners_; }
  Vec3 position(Index v) const {
    const Index extra = is_corner(v) ? 1 : 0, n = is_corner(v) ? v : v - corners_;
    const Index ny = cubes_[1] + extra, nz = cubes_[2] + extra;
    const Vec3 cell(static_cast<double>(n / (ny * nz)), static_cast<double>(n / nz % ny),
                    static_cast<double>(n % nz));
    return origin_ + spacing_ * (cell + Vec3::Constant(extra ? 0.0 : 0.5));
  }

  // visit(tetrahedron) for all of them: four about each face that two cubes share.
  template <class Visit>
  void for_each_cell(Visit&& visit) const {
    for (int axis = 0; axis < 3; ++axis) {
      std::array<Index, 3> last = cubes_, step{0, 0, 0}, u{0, 0, 0}, v{0, 0, 0};
      const auto d = usize(axis);
      --last[d];
      step[d] = 1;
      u[(d + 1) % 3] = 1;
      v[(d + 2) % 3] = 1;
      for (Index i = 0; i < last[0]; ++i) {
        poll_interrupt();
        for (Index j = 0; j < last[1]; ++j) {
          for (Index k = 0; k < last[2]; ++k) {
            const Index one = center(i, j, k), two = center(i + step[0], j + step[1], k + step[2]);
            const Index x = i + step[0], y = j + step[1], z = k + step[2];
            const Index ring[4] = {corner(x, y, z), corner(x + u[0], y + u[1], z + u[2]),
                                   corner(x + u[0] + v[0], y + u[1] + v[1], z + u[2] + v[2]),
                                   corner(x + v[0], y + v[1], z + v[2])};
            for (int side = 0; side < 4; ++side)
              visit(std::array<Index, 4>{one, two, ring[side], ring[(side + 1) % 4]});
          }
        }
      }
    }
  }

  std::vector<double> distance;  // of each vertex, below 0 inside

 private:
  Index corner(Index i, Index j, Index k) const {
    return (i * (cubes_[1] + 1) + j) * (cubes_[2] + 1) + k;
  }
  Index center(Index i, Index j, Index k) const {
    return corners_ + (i * cubes_[1] + j) * cubes_[2] + k;
  }

  double spacing_;
  std::array<Index, 3> cubes_;
  Vec3 origin_;
  Index corners_;
};

// The point of the surface on the edge from a to b, where the distances da and db differ in sign.
Vec3 find_cut(const TriangleTree& tree, Vec3 a, Vec3 b, double da, double db, double tolerance) {
  const bool a_inside = da < 0;
  double low = 0, high = 1, dl = std::abs(da), dh = std::abs(db);
  double t = dl / (dl + dh);
  for (int step = 0; step < 20; ++step) {
    const double d = tree.signed_distance(a + t * (b - a));
    if (std::abs(d) <= tolerance) break;
    if ((d < 0) == a_inside) {
      low = t, dl = std::abs(d);
    } else {
      high = t, dh = std::abs(d);
    }
    const double secant = low + (high - low) * dl / (dl + dh);
    t = step % 3 == 2 ? 0.5 * (low + high) : secant;
    if (high - low < 1e-3) break;
  }
  return a + t * (b - a);
}

class Stuffing {
 public:
  Stuffing(const TriangleTree& tree, double spacing, int threads)
      : lattice_(tree, spacing, threads), edges_from_(lattice_.distance.size()) {
    find_cuts(tree, spacing, threads);
    warp();
    lattice_.for_each_cell([&](const std::array<Index, 4>& cell) { fill(cell); });
  }
  Tetrahedra result;

 private:
  struct Cut {
    Index low, high;  // vertices of the edge
    Vec3 point;
    bool valid = true;  // no end has been drawn onto the surface
    Index number = -1;  // in the result
  };
  static std::uint64_t key(Index a, Index b) {
    return static_cast<std::uint64_t>(std::min(a, b)) << 32 |
           static_cast<std::uint64_t>(std::max(a, b));
  }
  double& distance(Index v) { return lattice_.distance[usize(v)]; }
  bool is_long(Index a, Index b) const { return lattice_.is_corner(a) == lattice_.is_corner(b); }

  void find_cuts(const TriangleTree& tree, double spacing, int threads) {
    lattice_.for_each_cell([&](const std::array<Index, 4>& cell) {
      for (std::size_t i = 0; i < 4; ++i) {
        for (std::size_t j = 0; j < i; ++j) {
          if ((distance(cell[i]) < 0) == (distance(cell[j]) < 0)) continue;
          const Index low = std::min(cell[i], cell[j]), high = std::max(cell[i], cell[j]);
          if (!cut_of_.emplace(key(low, high), cuts_.size()).second) continue;
          edges_from_[usize(low)].push_back(cuts_.size());
          edges_from_[usize(high)].push_back(cuts_.size());
          cuts_.push_back({low, high, Vec3::Zero()});
        }
      }
    });
    parallel_for(
        static_cast<Index>(cuts_.size()), 64,
        [&](Index begin, Index end) {
          for (Index i = begin; i < end; ++i) {
            Cut& cut = cuts_[usize(i)];
            cut.point = find_cut(tree, lattice_.position(cut.low), lattice_.position(cut.high),
                                 distance(cut.low), distance(cut.high), 1e-4 * spacing);
          }
        },
        threads);
  }

  // Section 3.3: vertices with a cut point close by move to the nearest such, and lie on the
  // surface from then on; the cut points of their edges are no more.
  void warp() {
    for (Index v = 0; v < static_cast<Index>(edges_from_.size()); ++v) {
      const auto& edges = edges_from_[usize(v)];
      const Cut* nearest = nullptr;
      double least = 1;
      for (const std::size_t e : edges) {
        const Cut& cut = cuts_[e];
        if (!cut.valid) continue;
        const Index other = cut.low == v ? cut.high : cut.low;
        const Vec3 x = lattice_.position(v);
        const double length = (lattice_.position(other) - x).norm();
        const double away = (cut.point - x).norm();
        const double limit = (is_long(v, other) ? kNearLong : kNearShort) * length;
        if (away < limit && (!nearest || away < least)) nearest = &cut, least = away;
      }
      if (!nearest) continue;
      moved_.emplace(v, nearest->point);
      distance(v) = 0;
      for (const std::size_t e : edges) cuts_[e].valid = false;
    }
  }

  Index vertex(Index v) {
    const auto [entry, added] = number_of_.emplace(v, result.vertices.size());
    if (added) {
      const auto moved = moved_.find(v);
      result.vertices.push_back(moved == moved_.end() ? lattice_.position(v) : moved->second);
    }
    return static_cast<Index>(entry->second);
  }
  Index cut_vertex(Index a, Index b) {
    Cut& cut = cuts_[cut_of_.at(key(a, b))];
    if (cut.number < 0) {
      cut.number = static_cast<Index>(result.vertices.size());
      result.vertices.push_back(cut.point);
    }
    return cut.number;
  }
  void add(Index a, Index b, Index c, Index d) {
    const auto& x = result.vertices;
    const auto at = [&](Index i) -> const Vec3& { return x[usize(i)]; };
    const double volume = (at(b) - at(a)).cross(at(c) - at(a)).dot(at(d) - at(a));
    if (volume > 0) result.cells.push_back({a, b, c, d});
    if (volume < 0) result.cells.push_back({a, b, d, c});
  }

  // Section 3.4: the part inside, by the signs of the vertices: inside < 0, on the surface 0.
  void fill(const std::array<Index, 4>& cell) {
    std::array<Index, 4> in{}, out{}, on{};
    std::size_t ins = 0, outs = 0, ons = 0;
    for (const Index v : cell) {
      if (distance(v) < 0) {
        in[ins++] = v;
      } else if (distance(v) > 0) {
        out[outs++] = v;
      } else {
        on[ons++] = v;
      }
    }
    if (ins == 0) return;
    if (outs == 0) {
      add(vertex(cell[0]), vertex(cell[1]), vertex(cell[2]), vertex(cell[3]));
    } else if (ins == 1) {
      // A tetrahedron again: the edges to the outside are cut short.
      Index v[4] = {vertex(in[0])};
      for (std::size_t i = 0; i < outs; ++i) v[1 + i] = cut_vertex(in[0], out[i]);
      for (std::size_t i = 0; i < ons; ++i) v[1 + outs + i] = vertex(on[i]);
      add(v[0], v[1], v[2], v[3]);
    } else if (ins == 2 && outs == 1) {
      // A pyramid over the quadrilateral (p, q, q', p') with its apex on the surface.
      const Quad quad = split(in[0], in[1], out[0]);
      const Index apex = vertex(on[0]);
      add(quad.from, quad.to, quad.one, apex);
      add(quad.from, quad.to, quad.two, apex);
    } else {
      fill_prism(in, ins, out);
    }
  }

  // The quadrilateral of the inside vertices p, q and the cut points p', q' of their edges to r,
  // and its diagonal. All cells about a face must choose alike, and the three diagonals of a prism
  // must not chase each other: so each runs from the vertex of the lowest rank.
  struct Quad {
    Index from, to, one, two;
  };
  Quad split(Index p, Index q, Index r) {
    const Index a = vertex(p), b = vertex(q), c = cut_vertex(q, r), d = cut_vertex(p, r);
    if (first(p, q, r)) return {a, c, b, d};
    return {b, d, a, c};
  }
  // The diagonal starts at p, not at q.
  bool first(Index p, Index q, Index r) const {
    if (is_long(p, r) != is_long(q, r)) return is_long(q, r);
    return p < q;
  }

  void fill_prism(const std::array<Index, 4>& in, std::size_t ins,
                  const std::array<Index, 4>& out) {
    // Triangles (a0, a1, a2) and (b0, b1, b2) with edges a_i b_i; rank[i][j]: the diagonal of the
    // side (a_i, a_j, b_j, b_i) starts at a_i.
    Index a[3], b[3];
    bool starts[3][3];
    if (ins == 3) {
      for (std::size_t i = 0; i < 3; ++i) {
        a[i] = vertex(in[i]);
        b[i] = cut_vertex(in[i], out[0]);
        for (std::size_t j = 0; j < 3; ++j) starts[i][j] = i != j && first(in[i], in[j], out[0]);
      }
    } else {
      // Two inside (p, q), two outside (r, s): a = (p, p r, p s), b = (q, q r, q s).
      const Index p = in[0], q = in[1];
      a[0] = vertex(p), b[0] = vertex(q);
      for (std::size_t i = 0; i < 2; ++i)
        a[1 + i] = cut_vertex(p, out[i]), b[1 + i] = cut_vertex(q, out[i]);
      for (std::size_t i = 0; i < 2; ++i) {
        starts[0][1 + i] = first(p, q, out[i]);
        starts[1 + i][0] = !starts[0][1 + i];
      }
      // The side on the surface belongs to this cell alone.
      starts[1][2] = starts[0][2] || !starts[0][1];
      starts[2][1] = !starts[1][2];
    }
    // Some a_i from which two diagonals start exists unless they chase each other.
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      if (!(starts[i][j] && starts[i][k])) continue;
      add(a[i], b[i], b[j], b[k]);
      if (starts[j][k]) {
        add(a[i], a[j], b[j], b[k]);
        add(a[i], a[j], a[k], b[k]);
      } else {
        add(a[i], a[k], b[j], b[k]);
        add(a[i], a[j], a[k], b[j]);
      }
      return;
    }
  }

  Lattice lattice_;
  std::vector<std::vector<std::size_t>> edges_from_;
  std::vector<Cut> cuts_;
  std::unordered_map<std::uint64_t, std::size_t> cut_of_;
  std::unordered_map<Index, Vec3> moved_;
  std::unordered_map<Index, std::size_t> number_of_;
};

}  // namespace

Tetrahedra stuff_isosurface(const TriangleTree& tree, double spacing, int threads) {
  return std::move(Stuffing(tree, spacing, threads).result);
}

}  // namespace substep::geometry
