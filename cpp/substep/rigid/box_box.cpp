#include "substep/rigid/box_box.h"

#include <algorithm>
#include <cmath>

#include "substep/core/matrix3.h"
#include "substep/rigid/contact_patch.h"
#include "substep/rigid/convex_contacts.h"

namespace substep::rigid {
namespace {

// Fractions of the smallest half length: what a side lets pass, so that the corners of aligned
// boxes stay corners, and by how much a later kind of axis must be better than an earlier one
// (faces of a, faces of b, crossings of edges), so that flat contact stays flat.
constexpr double kSlack = 1e-4, kPreference = 2e-2;

// b as seen from the frame of a.
struct Relative {
  Vec3 t;         // centre
  Mat3 R, abs_R;  // axes in columns
};

// Points where a face of `reference` (its axis `i`, outward along `sign`) meets the face of
// `incident` that looks against it. M: axes of the incident box in columns, c: its centre, both in
// the frame of the reference box. False where none is as low as the separation of the axis, so that
// other features are closest.
bool clip_faces(const Box& reference, const Pose& pose, int i, double sign, const Box& incident,
                const Mat3& M, const Vec3& c, double margin, double size, bool flipped,
                double separation, Manifold& manifold) {
  int j;
  M.row(i).cwiseAbs().maxCoeff(&j);
  const int j1 = (j + 1) % 3, j2 = (j + 2) % 3, u = (i + 1) % 3, v = (i + 2) % 3;
  const Vec3 &h = reference.half_lengths, &g = incident.half_lengths;
  const bool positive = sign * M(i, j) < 0;
  const Vec3 centre = c + (positive ? g[j] : -g[j]) * M.col(j);
  const Vec3 e1 = g[j1] * M.col(j1), e2 = g[j2] * M.col(j2);
  Patch patch;
  patch.count = 4;
  double far_u = 0, far_v = 0;
  for (std::uint32_t k = 0; k < 4; ++k) {
    const double s1 = k == 1 || k == 2 ? 1 : -1, s2 = k >= 2 ? 1 : -1;
    const Vec3 p = centre + s1 * e1 + s2 * e2;
    patch.corners[k] = {p[u], p[v], sign * p[i] - h[i], (k + 3) % 4, k};
    far_u = std::max(far_u, std::abs(p[u])), far_v = std::max(far_v, std::abs(p[v]));
  }
  const double slack = kSlack * size;
  if (far_u > h[u] + slack)
    clip(patch, {1, 0, h[u], 4}, slack), clip(patch, {-1, 0, h[u], 5}, slack);
  if (far_v > h[v] + slack)
    clip(patch, {0, 1, h[v], 6}, slack), clip(patch, {0, -1, h[v], 7}, slack);
  double lowest = 1e300;
  for (int k = 0; k < patch.count; ++k) lowest = std::min(lowest, patch.corners[k].height);
  if (lowest > separation + 2 * kPreference * size) return false;
  const Reduced reduced = reduce(patch, margin, kPreference * size);
  const Vec3 n = sign * pose.rotation.col(i);
  manifold.normal = flipped ? Vec3(-n) : n;
  const std::uint32_t faces =
      static_cast<std::uint32_t>(((2 * i + (sign > 0)) * 6 + 2 * j + positive) * 2 + flipped);
  for (int k = 0; k < reduced.count; ++k) {
    const PatchCorner& corner = patch.corners[reduced.index[k]];
    Vec3 p;
    p[i] = sign * (corner.height + h[i]), p[u] = corner.u, p[v] = corner.v;
    const Vec3 on_incident = pose.to_world(p);
    const Vec3 on_reference = on_incident - corner.height * n;
    manifold.add({flipped ? on_incident : on_reference, flipped ? on_reference : on_incident,
                  corner.height, corner_feature(corner, faces)});
  }
  return true;
}

// Where the edges along axis i of a and j of b that face each other along n (frame of a) cross.
// False where their lines do beyond their ends.
bool cross_edges(const Box& a, const Pose& pose_a, const Box& b, const Relative& rel, int i, int j,
                 const Vec3& n, double separation, Manifold& manifold) {
  // Midpoints of the edges.
  const Vec3 along_b = rel.R.transpose() * n;
  Vec3 p = Vec3::Zero(), q_local = Vec3::Zero();
  std::uint32_t feature = static_cast<std::uint32_t>(1 << 24 | i << 20 | j << 16);
  for (int k = 0; k < 3; ++k) {
    if (k != i) p[k] = n[k] > 0 ? a.half_lengths[k] : -a.half_lengths[k];
    if (k != j) q_local[k] = along_b[k] > 0 ? -b.half_lengths[k] : b.half_lengths[k];
    feature |= (p[k] > 0 ? 1u : 0u) << k | (q_local[k] > 0 ? 8u : 0u) << k;
  }
  const Vec3 q = rel.R * q_local + rel.t, d = rel.R.col(j), w = q - p;
  // p + s e_i and q + r d closest: with c = e_i . d, s (1 - c^2) = w_i - c w.d.
  const double c = d[i], wd = w.dot(d), s = (w[i] - c * wd) / std::max(1 - c * c, 1e-300);
  const double r = c * s - wd;
  const double beyond = std::max(std::abs(s) - a.half_lengths[i], std::abs(r) - b.half_lengths[j]);
  if (beyond > kSlack * a.half_lengths[i] && separation > 0) return false;
  p[i] = std::clamp(s, -a.half_lengths[i], a.half_lengths[i]);
  const Vec3 on_a = pose_a.to_world(p);
  manifold.normal = pose_a.rotation * n;
  manifold.add({on_a, on_a + separation * manifold.normal, separation, feature});
  return true;
}

// Axes e_i x R_j, of length l, the three j of one i at a time: l s = |t . axis| - h . |axis| - g .
// |axis in b|. False where one separates by more than the margin; else the best one above `best`.
bool best_edges(const Relative& rel, const Vec3& h, const Vec3& g, double margin, double& best,
                int& best_i, int& best_j) {
  using V = Vector<double, 32>;
  const V g1 = {g[1], g[2], g[0], 0}, g2 = {g[2], g[0], g[1], 0};
  V row[3], size[3];
  for (int i = 0; i < 3; ++i) {
    row[i] = V{rel.R(i, 0), rel.R(i, 1), rel.R(i, 2), 0};
    size[i] = V{rel.abs_R(i, 0), rel.abs_R(i, 1), rel.abs_R(i, 2), 0};
  }
  for (int i = 0; i < 3; ++i) {
    const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
    const V square = row[i1] * row[i1] + row[i2] * row[i2];
    const V along = rel.t[i2] * row[i1] - rel.t[i1] * row[i2];
    const V other1 = __builtin_shufflevector(size[i], size[i], 1, 2, 0, 3);
    const V other2 = __builtin_shufflevector(size[i], size[i], 2, 0, 1, 3);
    const V s = (along < 0 ? -along : along) - h[i1] * size[i2] - h[i2] * size[i1] - g1 * other2 -
                g2 * other1;
    const V l = square_root(square);
    const auto crossing = square > 1e-14;  // of parallel edges the axes of faces have said all
    if (any(crossing & (s > margin * l))) return false;
    if (!any(crossing & (s > best * l))) continue;
    for (int j = 0; j < 3; ++j) {
      if (crossing[j] && s[j] > best * l[j]) best = s[j] / l[j], best_i = i, best_j = j;
    }
  }
  return true;
}

}  // namespace

void box_box(const Box& a, const Pose& pose_a, const Box& b, const Pose& pose_b, double margin,
             Manifold& manifold, Cache& cache) {
  const Vec3 &h = a.half_lengths, &g = b.half_lengths;
  Relative rel;
  rel.t = pose_a.to_local(pose_b.position);
  rel.R = pose_a.rotation.transpose() * pose_b.rotation;
  rel.abs_R = rel.R.cwiseAbs();

  const Vec3 on_a = rel.t.cwiseAbs() - h - rel.abs_R * g;
  const Vec3 t_b = rel.R.transpose() * rel.t;
  const Vec3 on_b = t_b.cwiseAbs() - g - rel.abs_R.transpose() * h;
  int i, j;
  const double best_a = on_a.maxCoeff(&i), best_b = on_b.maxCoeff(&j);
  if (!(std::max(best_a, best_b) <= margin)) return;
  const double size = std::min(h.minCoeff(), g.minCoeff());
  const bool face_of_b = best_b > best_a + kPreference * size;
  const double face = face_of_b ? best_b : best_a;

  double edge = face + kPreference * size;
  int edge_i = -1, edge_j = -1;
  if (!best_edges(rel, h, g, margin, edge, edge_i, edge_j)) return;
  bool found;
  if (edge_i >= 0) {
    Vec3 n = Vec3::Unit(edge_i).cross(rel.R.col(edge_j)).normalized();
    if (n.dot(rel.t) < 0) n = -n;
    found = cross_edges(a, pose_a, b, rel, edge_i, edge_j, n, edge, manifold);
  } else if (!face_of_b) {
    found = clip_faces(a, pose_a, i, rel.t[i] < 0 ? -1 : 1, b, rel.R, rel.t, margin, size, false,
                       face, manifold);
  } else {
    found = clip_faces(b, pose_b, j, t_b[j] < 0 ? 1 : -1, a, rel.R.transpose(), -t_b, margin, size,
                       true, face, manifold);
  }
  if (found) return;
  // Apart, and closest at a corner: no axis of the fifteen is the direction of the distance.
  const BoxPolytope box_a(h), box_b(g);
  convex_convex(convex(a, box_a), pose_a, convex(b, box_b), pose_b, margin, manifold, cache);
}

}  // namespace substep::rigid
