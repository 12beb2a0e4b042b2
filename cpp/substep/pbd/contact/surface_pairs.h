// Which parts of a surface are near each other: a vertex and a triangle, or two edges, that share
// no vertex. Two triangles that do not meet now cannot come to do so before a vertex passes a
// triangle or an edge an edge, so these pairs are all that self-collision has to watch.
//
// A list holds for some time (Verlet 1967): found within a reach and a skin, it is complete within
// the reach until a vertex has moved by half the skin. Edges and triangles are found by points on
// them (geometry::Neighbours): long ones, where the surface is stretched, have several.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/geometry/neighbours.h"
#include "substep/geometry/vectors.h"

namespace substep::pbd {

// Vertex v[0] and triangle v[1], v[2], v[3] (first == 1), or edges v[0] v[1] and v[2] v[3]
// (first == 2): `first` vertices are on one side, the others on the other.
struct SurfacePair {
  std::array<std::int32_t, 4> v;
  std::int32_t first;
};

// Where the two are closest to each other: sum_i w_i x_i = d n, |n| = 1; d = 0 where they touch.
struct Closest {
  std::array<double, 4> w;
  geometry::Vec3 n;
  double d;
};
Closest closest(const SurfacePair& pair, const std::array<geometry::Vec3, 4>& x);

template <class Real>
class SurfacePairs {
 public:
  struct Candidate {
    std::uint64_t key;  // of the two parts
    SurfacePair pair;
    double distance;       // when the list was made
    double rest_distance;  // at rest
  };

  // Triangles of the rows of `rest`, which are the positions at rest.
  SurfacePairs(std::vector<std::array<std::int32_t, 3>> faces, std::vector<geometry::Vec3> rest);

  // All pairs closer than `reach` at x, and more. Their order does not depend on when they were
  // found.
  void update(const Point<Real>* x, double reach, int threads);
  std::span<const Candidate> candidates() const { return candidates_; }
  // What a candidate is apart at the positions of the last update(), at least.
  double least_distance(const Candidate& c) const { return (c.distance - approach_) * (1 - 1e-9); }

  const std::vector<std::array<std::int32_t, 3>>& faces() const { return faces_; }
  const std::vector<geometry::Vec3>& rest() const { return rest_; }
  std::span<const std::int32_t> vertices() const { return vertices_; }
  double mean_edge() const { return mean_edge_; }

 private:
  using Vec3 = geometry::Vec3;

  bool still_holds(const Point<Real>* x, double reach);
  void find(const Point<Real>* x, int threads);
  void sort_candidates(int threads);
  template <class Found>
  void search(std::vector<Point<Real>>& points, double radius, int threads, Found&& found);

  std::vector<std::array<std::int32_t, 3>> faces_;
  std::vector<std::array<std::int32_t, 2>> edges_;
  std::vector<std::int32_t> vertices_;
  std::vector<Vec3> rest_;
  double mean_edge_ = 0;

  geometry::Neighbours<Real> near_;
  std::vector<Candidate> candidates_;
  std::vector<Vec3> made_at_;  // of vertices_
  double within_ = 0;
  double approach_ = 0;  // how much closer than when the list was made a pair may have come
  RadixSort<std::uint64_t> radix_sort_;
};

}  // namespace substep::pbd
