#include "substep/geometry/triangle_tree.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::geometry {

namespace {

// Ericson, "Real-time collision detection" (2005), section 5.1.5: by the Voronoi region of x.
Vec3 nearest_on_triangle(const Vec3& x, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ax = x - a;
  const double d1 = ab.dot(ax), d2 = ac.dot(ax);
  if (d1 <= 0 && d2 <= 0) return a;
  const Vec3 bx = x - b;
  const double d3 = ab.dot(bx), d4 = ac.dot(bx);
  if (d3 >= 0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + d1 / (d1 - d3) * ab;
  const Vec3 cx = x - c;
  const double d5 = ab.dot(cx), d6 = ac.dot(cx);
  if (d6 >= 0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0)
    return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
  const double sum = va + vb + vc;
  return sum > 0 ? Vec3(a + vb / sum * ab + vc / sum * ac) : a;
}

// Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 125 (1983), eq. (8).
double solid_angle(const Vec3& x, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 u = a - x, v = b - x, w = c - x;
  const double lu = u.norm(), lv = v.norm(), lw = w.norm();
  const double above = u.dot(v.cross(w));
  const double below = lu * lv * lw + u.dot(v) * lw + v.dot(w) * lu + w.dot(u) * lv;
  return 2 * std::atan2(above, below);
}

double box_distance2(const Vec3& x, const Vec3& low, const Vec3& high) {
  return (low - x).cwiseMax(x - high).cwiseMax(0.0).squaredNorm();
}

// Both ends strictly on different sides of the face, and the line strictly inside of its edges.
bool pierces(const Vec3& p, const Vec3& q, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 normal = (b - a).cross(c - a), along = q - p;
  const double size = std::sqrt(std::max(
      {(b - a).squaredNorm(), (c - a).squaredNorm(), (c - b).squaredNorm(), along.squaredNorm()}));
  const double flat = 1e-9 * size * normal.norm();
  const double above = normal.dot(p - a), below = normal.dot(q - a);
  if (!((above > flat && below < -flat) || (above < -flat && below > flat))) return false;
  const double side = 1e-9 * size * size * size;
  const double u = along.dot((a - p).cross(b - p)), v = along.dot((b - p).cross(c - p)),
               w = along.dot((c - p).cross(a - p));
  return (u > side && v > side && w > side) || (u < -side && v < -side && w < -side);
}

bool directed_edges_cancel(const std::int64_t* faces, std::int64_t face_count) {
  struct Side {
    std::int64_t low, high, way;
  };
  std::vector<Side> sides;
  for (std::int64_t f = 0; f < face_count; ++f) {
    for (int k = 0; k < 3; ++k) {
      const std::int64_t a = faces[3 * f + k], b = faces[3 * f + (k + 1) % 3];
      sides.push_back({std::min(a, b), std::max(a, b), a < b ? 1 : -1});
    }
  }
  std::sort(sides.begin(), sides.end(), [](const Side& s, const Side& t) {
    return std::pair(s.low, s.high) < std::pair(t.low, t.high);
  });
  for (std::size_t i = 0; i < sides.size();) {
    std::int64_t sum = 0;
    const std::size_t first = i;
    for (;
         i < sides.size() && sides[i].low == sides[first].low && sides[i].high == sides[first].high;
         ++i)
      sum += sides[i].way;
    if (sum != 0) return false;
  }
  return true;
}

}  // namespace

TriangleTree::TriangleTree(const double* vertices, const std::int64_t* faces,
                           std::int64_t face_count) {
  triangles_.reserve(usize(face_count));
  const auto vertex = [&](std::int64_t f, int k) -> Vec3 {
    return Eigen::Map<const Vec3>(vertices + 3 * faces[3 * f + k]);
  };
  for (std::int64_t f = 0; f < face_count; ++f)
    triangles_.push_back({vertex(f, 0), vertex(f, 1), vertex(f, 2), f});
  nodes_.reserve(triangles_.size());
  expansions_.reserve(triangles_.size());
  build(0, static_cast<std::int32_t>(face_count));
  closed_ = directed_edges_cancel(faces, face_count);
  const Vec3 middle = 0.5 * (lower() + upper());
  double volume = 0;
  for (const Triangle& t : triangles_)
    volume += (t.a - middle).dot((t.b - middle).cross(t.c - middle));
  orientation_ = volume < 0 ? -1 : 1;
}

// Splits at the median of the centroids along the longest axis of the box.
void TriangleTree::build(std::int32_t first, std::int32_t last) {
  const auto index = nodes_.size();
  Node node;
  node.low = node.high = triangles_[usize(first)].a;
  for (std::int32_t i = first; i < last; ++i) {
    const Triangle& t = triangles_[usize(i)];
    node.low = node.low.cwiseMin(t.a).cwiseMin(t.b).cwiseMin(t.c);
    node.high = node.high.cwiseMax(t.a).cwiseMax(t.b).cwiseMax(t.c);
  }
  expansions_.push_back(expand(first, last));
  node.first = first;
  node.count = last - first <= kLeaf ? last - first : 0;
  node.right = 0;
  nodes_.push_back(node);
  if (node.count > 0) return;
  int axis;
  (node.high - node.low).maxCoeff(&axis);
  const auto key = [&](const Triangle& t) {
    return std::pair(t.a[axis] + t.b[axis] + t.c[axis], t.face);
  };
  const std::int32_t middle = first + (last - first) / 2;
  std::nth_element(triangles_.begin() + first, triangles_.begin() + middle,
                   triangles_.begin() + last,
                   [&](const Triangle& s, const Triangle& t) { return key(s) < key(t); });
  build(first, middle);
  nodes_[index].right = static_cast<std::int32_t>(nodes_.size());
  build(middle, last);
}

TriangleTree::Expansion TriangleTree::expand(std::int32_t first, std::int32_t last) const {
  double area = 0;
  Vec3 weighted = Vec3::Zero();
  for (std::int32_t i = first; i < last; ++i) {
    const auto& [a, b, c, face] = triangles_[usize(i)];
    const double part = 0.5 * (b - a).cross(c - a).norm();
    area += part;
    weighted += part * (a + b + c) / 3;
  }
  Expansion e{area > 0 ? Vec3(weighted / area) : triangles_[usize(first)].a, Vec3::Zero(),
              Mat3::Zero(), 0};
  double radius2 = 0;
  for (std::int32_t i = first; i < last; ++i) {
    const auto& [a, b, c, face] = triangles_[usize(i)];
    const Vec3 normal = 0.5 * (b - a).cross(c - a);  // of the length of the area
    e.dipole += normal;
    e.quadrupole += normal * ((a + b + c) / 3 - e.center).transpose();
    for (const Vec3& corner : {a, b, c})
      radius2 = std::max(radius2, (corner - e.center).squaredNorm());
  }
  e.radius = std::sqrt(radius2);
  return e;
}

TriangleTree::Nearest TriangleTree::nearest(const Vec3& x, double bound) const {
  Nearest best;
  double best2 = bound * bound;
  // Depth first, the nearer child first. The depth is below 64: each level halves the triangles.
  struct Entry {
    std::int32_t node;
    double distance2;
  };
  Entry stack[64];
  int top = 0;
  stack[top++] = {0, box_distance2(x, nodes_[0].low, nodes_[0].high)};
  while (top > 0) {
    const Entry entry = stack[--top];
    if (entry.distance2 > best2) continue;
    const Node& node = nodes_[usize(entry.node)];
    for (std::int32_t i = node.first; i < node.first + node.count; ++i) {
      const Triangle& t = triangles_[usize(i)];
      const Vec3 point = nearest_on_triangle(x, t.a, t.b, t.c);
      const double distance2 = (x - point).squaredNorm();
      if (distance2 < best2 || (best.face < 0 && distance2 == best2)) {
        best2 = distance2;
        best = {0, point, t.face};
      }
    }
    if (node.count > 0) continue;
    const auto child = [&](std::int32_t i) -> Entry {
      const Node& n = nodes_[usize(i)];
      return {i, box_distance2(x, n.low, n.high)};
    };
    Entry near = child(entry.node + 1), far = child(node.right);
    if (far.distance2 < near.distance2) std::swap(near, far);
    stack[top++] = far;
    stack[top++] = near;
  }
  if (best.face >= 0) best.distance = std::sqrt(best2);
  return best;
}

double TriangleTree::winding_number(const Vec3& x) const {
  double sum = 0;
  std::int32_t stack[64];
  int top = 0;
  stack[top++] = 0;
  while (top > 0) {
    const std::int32_t index = stack[--top];
    const Expansion& e = expansions_[usize(index)];
    const Vec3 r = e.center - x;
    const double r2 = r.squaredNorm();
    if (r2 > kFar * kFar * e.radius * e.radius) {
      // grad G = r / (4 pi |r|^3) and its gradient (1 - 3 r r^T / |r|^2) / (4 pi |r|^3), eq. (13);
      // the factor 4 pi is taken out of the sum.
      const double inverse = 1 / (r2 * std::sqrt(r2));
      sum += inverse * (e.dipole.dot(r) + e.quadrupole.trace() - 3 / r2 * r.dot(e.quadrupole * r));
      continue;
    }
    const Node& node = nodes_[usize(index)];
    for (std::int32_t i = node.first; i < node.first + node.count; ++i) {
      const Triangle& t = triangles_[usize(i)];
      sum += solid_angle(x, t.a, t.b, t.c);
    }
    if (node.count > 0) continue;
    stack[top++] = node.right;
    stack[top++] = index + 1;
  }
  return sum / (4 * std::numbers::pi);
}

std::int64_t TriangleTree::count_pierced(const double* vertices, const std::int64_t* faces,
                                         const std::int64_t* edges, std::int64_t edge_count,
                                         int threads) const {
  const auto pierced = [&](std::int64_t i, std::int64_t j) {
    const Vec3 p = Eigen::Map<const Vec3>(vertices + 3 * i);
    const Vec3 q = Eigen::Map<const Vec3>(vertices + 3 * j);
    const Vec3 low = p.cwiseMin(q), high = p.cwiseMax(q);
    std::int32_t stack[64];
    int top = 0;
    stack[top++] = 0;
    while (top > 0) {
      const std::int32_t index = stack[--top];
      const Node& node = nodes_[usize(index)];
      if ((node.low.array() > high.array()).any() || (node.high.array() < low.array()).any())
        continue;
      for (std::int32_t k = node.first; k < node.first + node.count; ++k) {
        const Triangle& t = triangles_[usize(k)];
        const std::int64_t* f = faces + 3 * t.face;
        const bool shares = std::any_of(f, f + 3, [&](auto v) { return v == i || v == j; });
        if (!shares && pierces(p, q, t.a, t.b, t.c)) return true;
      }
      if (node.count > 0) continue;
      stack[top++] = node.right;
      stack[top++] = index + 1;
    }
    return false;
  };
  constexpr std::int64_t kGrain = 1024;
  std::vector<std::int64_t> found(usize(edge_count / kGrain + 1), 0);
  parallel_for(
      edge_count, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t e = begin; e < end; ++e)
          found[usize(begin / kGrain)] += pierced(edges[2 * e], edges[2 * e + 1]) ? 1 : 0;
      },
      threads);
  return std::accumulate(found.begin(), found.end(), std::int64_t{0});
}

}  // namespace substep::geometry
