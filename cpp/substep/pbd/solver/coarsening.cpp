#include "substep/pbd/solver/coarsening.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

using geometry::Mat3;

double distance(const std::array<double, 3>& a, const std::array<double, 3>& b) {
  return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

// Of each particle: its edges.
Rows edges_of(const DistanceGraph& graph) {
  Rows rows;
  rows.start.assign(graph.rest.size() + 1, 0);
  for (const auto& e : graph.edges) {
    ++rows.start[usize(e.i) + 1];
    ++rows.start[usize(e.j) + 1];
  }
  for (std::size_t v = 0; v < graph.rest.size(); ++v) rows.start[v + 1] += rows.start[v];
  rows.index.resize(2 * graph.edges.size());
  std::vector<std::int32_t> next(rows.start.begin(), rows.start.end() - 1);
  for (std::size_t k = 0; k < graph.edges.size(); ++k) {
    for (const std::int32_t v : {graph.edges[k].i, graph.edges[k].j}) {
      rows.index[usize(next[usize(v)]++)] = static_cast<std::int32_t>(k);
    }
  }
  return rows;
}

template <class Visit>  // visit(edge, the particle at its other end)
void for_neighbours(const DistanceGraph& graph, const Rows& rows, std::size_t v, Visit&& visit) {
  for (std::int32_t k = rows.start[v]; k < rows.start[v + 1]; ++k) {
    const std::int32_t e = rows.index[usize(k)];
    const auto& edge = graph.edges[usize(e)];
    visit(e, usize(edge.i) == v ? edge.j : edge.i);
  }
}

// Number among the coarse particles of each fine one, -1 where it is none: all pinned ones, and of
// the others a maximal independent set of the graph, greedily in their order.
std::vector<std::int32_t> choose(const DistanceGraph& graph, const Rows& rows) {
  constexpr std::int32_t kUndecided = -2;
  std::vector<std::int32_t> number(graph.rest.size(), kUndecided);
  std::int32_t count = 0;
  const auto take = [&](std::size_t v) {
    number[v] = count++;
    for_neighbours(graph, rows, v, [&](std::int32_t, std::int32_t u) {
      std::int32_t& other = number[usize(u)];
      if (other == kUndecided) other = -1;
    });
  };
  const auto held = [&](std::size_t v) { return rows.start[v + 1] > rows.start[v]; };
  for (std::size_t v = 0; v < number.size(); ++v) {
    if (graph.mass[v] == 0 && held(v)) take(v);
  }
  // A pinned particle may be the neighbour of one that was taken.
  for (std::size_t v = 0; v < number.size(); ++v) {
    if (graph.mass[v] == 0 && held(v) && number[v] < 0) number[v] = count++;
  }
  for (std::size_t v = 0; v < number.size(); ++v) {
    if (number[v] == kUndecided && held(v)) take(v);
  }
  for (std::int32_t& n : number) n = std::max(n, -1);
  return number;
}

void centre_masses(const DistanceGraph& fine, const std::vector<std::int32_t>& number,
                   Coarsening& c) {
  const std::size_t n = c.coarse.rest.size();
  std::vector<std::vector<std::pair<std::int32_t, double>>> parts(n);
  for (std::size_t v = 0; v < fine.rest.size(); ++v) {
    if (fine.mass[v] == 0) {
      if (number[v] >= 0) {
        parts[usize(number[v])] = {{static_cast<std::int32_t>(v), 1.0}};
      }
      continue;
    }
    const std::int32_t begin = c.followed.start[v], end = c.followed.start[v + 1];
    for (std::int32_t k = begin; k < end; ++k) {
      const auto at = usize(c.followed.index[usize(k)]);
      if (c.coarse.mass[at] == 0) continue;
      parts[at].emplace_back(static_cast<std::int32_t>(v), fine.mass[v] / (end - begin));
    }
  }
  for (std::size_t at = 0; at < n; ++at) {
    double sum = 0;
    for (const auto& part : parts[at]) sum += part.second;
    if (c.coarse.mass[at] > 0) c.coarse.mass[at] = sum;
    c.coarse.rest[at] = {0, 0, 0};
    c.coarse.directions.push_back(Mat3::Zero());
    for (const auto& [v, mass] : parts[at]) {
      c.members.index.push_back(v);
      c.member_weight.push_back(mass / sum);
      c.coarse.directions[at] += mass / sum * fine.directions[usize(v)];
      for (std::size_t k = 0; k < 3; ++k) {
        c.coarse.rest[at][k] += mass / sum * fine.rest[usize(v)][k];
      }
    }
    c.members.start.push_back(static_cast<std::int32_t>(c.members.index.size()));
  }
}

// How much longer a chord between coarse particles is when the rest shape is laid flat; 0 where it
// turns too much. On an arc that turns by t between them the chord is sin(t / 2) / (t / 2) of the
// way, and centres of mass of weights that fall off linearly over t lie at the square of that part
// of the radius.
double unrolled(const Mat3& a, const Mat3& b) {
  constexpr double kHeld = 0.5, kEven = 0.85, kMostTurn = 0.5;  // cos(60 degrees)
  if (a.trace() < kHeld || b.trace() < kHeld) return 1;
  Eigen::SelfAdjointEigenSolver<Mat3> of_a, of_b;
  of_a.computeDirect(a);
  of_b.computeDirect(b);
  if (of_a.eigenvalues()[2] < kEven * a.trace() || of_b.eigenvalues()[2] < kEven * b.trace()) {
    return 0;
  }
  const double cosine = std::abs(of_a.eigenvectors().col(2).dot(of_b.eigenvectors().col(2)));
  if (cosine < kMostTurn) return 0;
  const double half = 0.5 * std::acos(std::min(cosine, 1.0));
  const double part = half > 1e-4 ? std::sin(half) / half : 1;
  return 1 / (part * part * part);
}

// Coarse particles are joined where the fine ones next to them are, along the shortest such path.
void join(const DistanceGraph& fine, const Rows& rows, const std::vector<std::int32_t>& number,
          Coarsening& c) {
  struct Parent {
    std::int32_t particle = -1, edge = -1;  // the nearest coarse particle (as a fine one); the way
    double distance = std::numeric_limits<double>::max();
  };
  std::vector<Parent> parent(fine.rest.size());
  for (std::size_t v = 0; v < parent.size(); ++v) {
    if (number[v] >= 0) {
      parent[v] = {static_cast<std::int32_t>(v), -1, 0};
      continue;
    }
    for_neighbours(fine, rows, v, [&](std::int32_t e, std::int32_t u) {
      const double d = fine.edges[usize(e)].length;
      if (number[usize(u)] >= 0 && d < parent[v].distance) parent[v] = {u, e, d};
    });
  }
  struct Candidate {
    std::int32_t i, j;  // i < j
    double length;
    std::int32_t edge;
  };
  std::vector<Candidate> candidates;
  for (std::size_t k = 0; k < fine.edges.size(); ++k) {
    const auto& e = fine.edges[k];
    const Parent &a = parent[usize(e.i)], &b = parent[usize(e.j)];
    if (a.particle == b.particle || a.particle < 0 || b.particle < 0) continue;
    const std::int32_t i = number[usize(a.particle)];
    const std::int32_t j = number[usize(b.particle)];
    if (c.coarse.mass[usize(i)] == 0 && c.coarse.mass[usize(j)] == 0) {
      continue;
    }
    candidates.push_back({std::min(i, j), std::max(i, j), a.distance + e.length + b.distance,
                          static_cast<std::int32_t>(k)});
  }
  std::sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
    return std::tie(a.i, a.j, a.length, a.edge) < std::tie(b.i, b.j, b.length, b.edge);
  });
  for (std::size_t k = 0; k < candidates.size(); ++k) {
    const Candidate& best = candidates[k];
    if (k > 0 && best.i == candidates[k - 1].i && best.j == candidates[k - 1].j) continue;
    std::int32_t from = fine.edges[usize(best.edge)].i;
    std::int32_t to = fine.edges[usize(best.edge)].j;
    const auto end = [&](std::int32_t v) { return number[usize(parent[usize(v)].particle)]; };
    if (end(from) != best.i) std::swap(from, to);
    const Parent& a = parent[usize(from)];
    const Parent& b = parent[usize(to)];
    // How long the path is in the rest shape: there may be some strain in it.
    const std::array<std::int32_t, 4> points{a.particle, from, to, b.particle};
    double strained = 0;
    for (std::size_t p = 0; p < 3; ++p) {
      strained += distance(fine.rest[usize(points[p])], fine.rest[usize(points[p + 1])]);
    }
    const double chord = distance(c.coarse.rest[usize(best.i)], c.coarse.rest[usize(best.j)]);
    if (!(chord > 0) || !(strained > 0)) continue;
    const double longer =
        unrolled(c.coarse.directions[usize(best.i)], c.coarse.directions[usize(best.j)]);
    if (longer == 0) continue;
    c.coarse.edges.push_back({best.i, best.j, longer * chord * best.length / strained});
    c.path.push_back({a.edge, best.edge, b.edge});
    c.path_points.push_back(points);
  }
}

}  // namespace

std::int64_t DistanceGraph::free() const {
  return std::count_if(mass.begin(), mass.end(), [](double m) { return m > 0; });
}

void find_directions(DistanceGraph& graph) {
  // By the spread of the edges at a particle: eigenvalues of sum u u^T in rising order.
  constexpr double kRope = 0.05, kSheet = 0.25;
  const Rows rows = edges_of(graph);
  graph.directions.assign(graph.rest.size(), Mat3::Zero());
  for (std::size_t v = 0; v < graph.rest.size(); ++v) {
    Mat3 spread = Mat3::Zero();
    for_neighbours(graph, rows, v, [&](std::int32_t, std::int32_t u) {
      const auto &p = graph.rest[v], &q = graph.rest[usize(u)];
      const geometry::Vec3 d(p[0] - q[0], p[1] - q[1], p[2] - q[2]);
      if (d.squaredNorm() > 0) spread += d * d.transpose() / d.squaredNorm();
    });
    if (!(spread.trace() > 0)) continue;
    Eigen::SelfAdjointEigenSolver<Mat3> axes;
    axes.computeDirect(spread);
    const geometry::Vec3 size = axes.eigenvalues();
    const bool rope = size[1] < kRope * size[2], sheet = size[0] < kSheet * size[1];
    if (!rope && !sheet) continue;
    const geometry::Vec3 d = axes.eigenvectors().col(rope ? 2 : 0);
    graph.directions[v] = d * d.transpose();
  }
}

Coarsening coarsen(const DistanceGraph& fine) {
  const Rows rows = edges_of(fine);
  const std::vector<std::int32_t> number = choose(fine, rows);
  Coarsening c;
  for (std::size_t v = 0; v < number.size(); ++v) {
    if (number[v] < 0) continue;
    const auto at = usize(number[v]);
    if (c.coarse.rest.size() <= at) {
      c.coarse.rest.resize(at + 1);
      c.coarse.mass.resize(at + 1);
    }
    c.coarse.mass[at] = fine.mass[v];
  }
  for (std::size_t v = 0; v < number.size(); ++v) {
    if (number[v] >= 0) {
      c.followed.index.push_back(number[v]);
    } else {
      for_neighbours(fine, rows, v, [&](std::int32_t, std::int32_t u) {
        const std::int32_t at = number[usize(u)];
        if (at >= 0) c.followed.index.push_back(at);
      });
    }
    c.followed.start.push_back(static_cast<std::int32_t>(c.followed.index.size()));
  }
  centre_masses(fine, number, c);
  join(fine, rows, number, c);
  return c;
}

}  // namespace substep::pbd
