#include "substep/pbd/contact/surface_pairs.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/closest_points.h"

namespace substep::pbd {
namespace {

using geometry::Vec3;

constexpr double kSkin = 0.5;    // in mean edges
constexpr double kPiece = 1.5;   // longest piece of an edge, in mean edges at rest or now
constexpr int kMostPieces = 64;  // of an edge: longer pieces make the search wider
constexpr std::int64_t kPointsPerTask = 512;

template <class Real>
Point<Real> point(const Vec3& v) {
  return {static_cast<Real>(v[0]), static_cast<Real>(v[1]), static_cast<Real>(v[2]), 0};
}

template <class Row>
void make_unique(std::vector<Row>& rows) {
  std::sort(rows.begin(), rows.end());
  rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
}

bool share(const SurfacePair& pair) {
  for (int a = 0; a < pair.first; ++a) {
    for (int b = pair.first; b < 4; ++b) {
      if (pair.v[usize(a)] == pair.v[usize(b)]) return true;
    }
  }
  return false;
}

}  // namespace

Closest closest(const SurfacePair& pair, const std::array<Vec3, 4>& x) {
  Closest c;
  if (pair.first == 1) {
    const auto w = geometry::closest_on_triangle(x[0], x[1], x[2], x[3]);
    c.w = {1, -w[0], -w[1], -w[2]};
  } else {
    const auto [s, t] = geometry::closest_on_segments(x[0], x[1], x[2], x[3]);
    c.w = {1 - s, s, t - 1, -t};
  }
  c.n = c.w[0] * x[0] + c.w[1] * x[1] + c.w[2] * x[2] + c.w[3] * x[3];
  c.d = c.n.norm();
  if (c.d > 0) c.n /= c.d;
  return c;
}

template <class Real>
SurfacePairs<Real>::SurfacePairs(std::vector<std::array<std::int32_t, 3>> faces,
                                 std::vector<Vec3> rest)
    : faces_(std::move(faces)), rest_(std::move(rest)) {
  for (const auto& f : faces_) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::int32_t a = f[k], b = f[(k + 1) % 3];
      edges_.push_back({std::min(a, b), std::max(a, b)});
      vertices_.push_back(a);
    }
  }
  make_unique(edges_);
  make_unique(vertices_);
  for (const auto& [a, b] : edges_) {
    mean_edge_ += (rest_[usize(a)] - rest_[usize(b)]).norm();
  }
  if (!edges_.empty()) mean_edge_ /= static_cast<double>(edges_.size());
}

template <class Real>
void SurfacePairs<Real>::update(const Point<Real>* x, double reach, int threads) {
  if (still_holds(x, reach)) return;
  within_ = reach + kSkin * mean_edge_;
  find(x, threads);
  sort_candidates(threads);
  made_at_.clear();
  for (const std::int32_t v : vertices_) made_at_.push_back(xyz(x[v]));
  approach_ = 0;
}

// A motion that all share brings nothing closer.
template <class Real>
bool SurfacePairs<Real>::still_holds(const Point<Real>* x, double reach) {
  if (made_at_.empty()) return false;
  Vec3 mean = Vec3::Zero();
  for (std::size_t k = 0; k < vertices_.size(); ++k) mean += xyz(x[vertices_[k]]) - made_at_[k];
  mean /= static_cast<double>(vertices_.size());
  double most = 0;
  for (std::size_t k = 0; k < vertices_.size(); ++k) {
    most = std::max(most, (xyz(x[vertices_[k]]) - made_at_[k] - mean).squaredNorm());
  }
  approach_ = 2 * std::sqrt(most);
  return reach + approach_ <= within_;
}

// By their keys, each once: pieces find some of them more often.
template <class Real>
void SurfacePairs<Real>::sort_candidates(int threads) {
  std::vector<KeyedIndex<std::uint64_t>> entries(candidates_.size());
  for (std::size_t k = 0; k < entries.size(); ++k) {
    entries[k] = {candidates_[k].key, static_cast<std::int32_t>(k)};
  }
  radix_sort_(entries, 63, threads);
  std::vector<Candidate> sorted;
  sorted.reserve(entries.size());
  for (const auto& entry : entries) {
    if (!sorted.empty() && sorted.back().key == entry.key) continue;
    sorted.push_back(candidates_[usize(entry.index)]);
  }
  candidates_.swap(sorted);
}

// found(i, j, list of this task) for pairs i < j of points closer than the radius.
template <class Real>
template <class Found>
void SurfacePairs<Real>::search(std::vector<Point<Real>>& points, double radius, int threads,
                                Found&& found) {
  double largest = 0;
  for (const Point<Real>& p : points) largest = std::max(largest, xyz(p).cwiseAbs().maxCoeff());
  const double rounding = 8 * largest * std::numeric_limits<Real>::epsilon();
  const auto wide = static_cast<Real>((radius + rounding) * (1 + 1e-4));
  near_.sort(points, wide, threads);
  std::vector<Point<Real>> sorted;
  sorted.reserve(points.size());
  for (const std::int32_t i : near_.order()) sorted.push_back(points[usize(i)]);
  near_.find(sorted, wide, geometry::Pairs::kHalf, threads);
  const std::int64_t n = near_.size();
  std::vector<std::vector<Candidate>> parts(usize((n + kPointsPerTask - 1) / kPointsPerTask));
  parallel_for(
      n, kPointsPerTask,
      [&](std::int64_t begin, std::int64_t end) {
        auto& part = parts[usize(begin / kPointsPerTask)];
        for (std::int64_t k = begin; k < end; ++k) {
          const geometry::NeighbourList list = near_[k];
          const std::int32_t i = near_.order()[usize(k)];
          for (std::int32_t m = 0; m < list.count; ++m) {
            const std::int32_t j = near_.order()[usize(list.indices[m])];
            found(std::min(i, j), std::max(i, j), part);
          }
        }
      },
      threads);
  for (const auto& part : parts) candidates_.insert(candidates_.end(), part.begin(), part.end());
}

template <class Real>
void SurfacePairs<Real>::find(const Point<Real>* x, int threads) {
  candidates_.clear();
  const double within = within_;
  const auto consider = [&](std::uint64_t key, const SurfacePair& pair,
                            std::vector<Candidate>& list) {
    if (share(pair)) return;
    std::array<Vec3, 4> now, rest;
    for (std::size_t k = 0; k < 4; ++k) {
      now[k] = xyz(x[pair.v[k]]);
      rest[k] = rest_[usize(pair.v[k])];
    }
    const double distance = closest(pair, now).d;
    if (distance < within) list.push_back({key, pair, distance, closest(pair, rest).d});
  };
  // Where all is torn apart, pieces as long as for the surface at rest would be without number.
  double present = 0;
  for (const auto& [a, b] : edges_) present += (xyz(x[a]) - xyz(x[b])).norm();
  present /= static_cast<double>(std::max<std::size_t>(edges_.size(), 1));
  const auto pieces = [&](double length) {
    const double wanted = std::ceil(length / (kPiece * std::max(mean_edge_, present)));
    return static_cast<int>(std::clamp(wanted, 1.0, static_cast<double>(kMostPieces)));
  };
  std::vector<Point<Real>> points;
  std::vector<std::int32_t> owner;
  // Edges: any point of a piece is within half its length of its middle.
  double longest = 0;
  for (std::size_t e = 0; e < edges_.size(); ++e) {
    const Vec3 a = xyz(x[edges_[e][0]]), b = xyz(x[edges_[e][1]]);
    const int count = pieces((b - a).norm());
    longest = std::max(longest, (b - a).norm() / count);
    for (int k = 0; k < count; ++k) {
      points.push_back(point<Real>(a + (k + 0.5) / count * (b - a)));
      owner.push_back(static_cast<std::int32_t>(e));
    }
  }
  search(points, longest + within, threads,
         [&](std::int32_t i, std::int32_t j, std::vector<Candidate>& list) {
           const auto e = usize(owner[usize(i)]);
           const auto f = usize(owner[usize(j)]);
           const auto &a = edges_[e], &b = edges_[f];
           consider(e << 31 | f, {{a[0], a[1], b[0], b[1]}, 2}, list);
         });
  // Triangles: any point of a piece, cut parallel to the sides, is within two thirds of its
  // longest side of its middle. The vertices come first.
  points.clear();
  owner.clear();
  longest = 0;
  for (const std::int32_t v : vertices_) points.push_back({x[v].x, x[v].y, x[v].z, 0});
  const auto vertices = static_cast<std::int32_t>(points.size());
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    const Vec3 a = xyz(x[faces_[f][0]]), b = xyz(x[faces_[f][1]]), c = xyz(x[faces_[f][2]]);
    const double side = std::max({(b - a).norm(), (c - b).norm(), (a - c).norm()});
    const int count = pieces(side);
    longest = std::max(longest, side / count);
    for (int i = 0; i < count; ++i) {
      for (int j = 0; i + j < count; ++j) {
        for (int turned = 0; turned < (i + j + 1 < count ? 2 : 1); ++turned) {
          const double s = (i + (1 + turned) / 3.0) / count, t = (j + (1 + turned) / 3.0) / count;
          points.push_back(point<Real>(a + s * (b - a) + t * (c - a)));
          owner.push_back(static_cast<std::int32_t>(f));
        }
      }
    }
  }
  search(points, 2 * longest / 3 + within, threads,
         [&](std::int32_t i, std::int32_t j, std::vector<Candidate>& list) {
           if (i >= vertices || j < vertices) return;
           const auto v = usize(i);
           const auto f = usize(owner[usize(j - vertices)]);
           const auto& corner = faces_[f];
           consider(std::uint64_t{1} << 62 | v << 31 | f,
                    {{vertices_[v], corner[0], corner[1], corner[2]}, 1}, list);
         });
}

template class SurfacePairs<float>;
template class SurfacePairs<double>;

}  // namespace substep::pbd
