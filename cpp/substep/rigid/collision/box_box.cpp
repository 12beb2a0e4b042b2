#include "substep/rigid/collision/box_box.h"

#include <algorithm>
#include <cmath>

#include "substep/core/matrix3.h"
#include "substep/rigid/collision/contact_patch.h"
#include "substep/rigid/collision/convex_contacts.h"

namespace substep::rigid {
namespace {

// Fractions of the smallest half length: what a side lets pass, so that the corners of aligned
// boxes stay corners, and by how much a later kind of axis must be better than an earlier one
// (faces of a, faces of b, crossings of edges), so that flat contact stays flat. Edge lies on edge
// where a face of each separates equally well and they are not as parallel as kFlat.
constexpr double kBoxSlack = 1e-4, kFacePreference = 2e-2, kFlat = 0.95;

using V = Vector<double, 32>;  // three lanes of use, 0 in the last

SUBSTEP_INLINE V lanes(const Vec3& v) { return V{v.x(), v.y(), v.z(), 0}; }
SUBSTEP_INLINE Vec3 vec3(const V& v) { return {v[0], v[1], v[2]}; }
SUBSTEP_INLINE V magnitude(const V& v) { return v < 0 ? -v : v; }

// The rows of a rotation. along(x): x in the frame that it turns to the world.
struct Rows {
  explicit Rows(const Mat3& M)
      : r{V{M(0, 0), M(0, 1), M(0, 2), 0}, V{M(1, 0), M(1, 1), M(1, 2), 0},
          V{M(2, 0), M(2, 1), M(2, 2), 0}} {}
  SUBSTEP_INLINE V along(double x, double y, double z) const {
    return fma(z, r[2], fma(y, r[1], x * r[0]));
  }
  V r[3];
};

// Each box as seen from the frame of the other.
struct Relative {
  Relative(const Pose& pose_a, const Pose& pose_b) {
    const Rows a(pose_a.rotation), b(pose_b.rotation);
    const Mat3 &A = pose_a.rotation, &B = pose_b.rotation;
    const Vec3 d = pose_b.position - pose_a.position;
    t_a = a.along(d.x(), d.y(), d.z());
    t_b = b.along(d.x(), d.y(), d.z());
    for (int i = 0; i < 3; ++i) {
      b_in_a[i] = a.along(B(0, i), B(1, i), B(2, i));
      a_in_b[i] = b.along(A(0, i), A(1, i), A(2, i));
    }
  }
  V t_a, t_b;              // from the centre of a to that of b, in the frames of a and b
  V b_in_a[3], a_in_b[3];  // axes
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
  const double slack = kBoxSlack * size;
  if (far_u > h[u] + slack)
    clip(patch, {1, 0, h[u], 4}, slack), clip(patch, {-1, 0, h[u], 5}, slack);
  if (far_v > h[v] + slack)
    clip(patch, {0, 1, h[v], 6}, slack), clip(patch, {0, -1, h[v], 7}, slack);
  double lowest = 1e300;
  for (int k = 0; k < patch.count; ++k) lowest = std::min(lowest, patch.corners[k].height);
  if (lowest > separation + 2 * kFacePreference * size) return false;
  const Reduced reduced = reduce(patch, margin, kFacePreference * size);
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

// The edges along axis i of a and j of b that face each other along n (frame of a).
struct FacingEdges {
  FacingEdges(const Box& a, const Box& b, const Mat3& R, const Vec3& t, int i, int j,
              const Vec3& n) {
    const Vec3 along_b = R.transpose() * n;
    Vec3 local = Vec3::Zero();
    feature = static_cast<std::uint32_t>(i << 20 | j << 16);
    for (int k = 0; k < 3; ++k) {
      if (k != i) p[k] = n[k] > 0 ? a.half_lengths[k] : -a.half_lengths[k];
      if (k != j) local[k] = along_b[k] > 0 ? -b.half_lengths[k] : b.half_lengths[k];
      feature |= (p[k] > 0 ? 1u : 0u) << k | (local[k] > 0 ? 8u : 0u) << k;
    }
    q = R * local + t;
  }
  Vec3 p = Vec3::Zero(), q;  // their midpoints, of a and of b
  std::uint32_t feature;
};

// Where they cross. False where their lines do beyond their ends.
bool cross_edges(const Box& a, const Pose& pose_a, const Box& b, const Mat3& R, const Vec3& t,
                 int i, int j, const Vec3& n, double separation, Manifold& manifold) {
  const FacingEdges edges(a, b, R, t, i, j, n);
  Vec3 p = edges.p;
  const Vec3 d = R.col(j), w = edges.q - p;
  // p + s e_i and q + r d closest: with c = e_i . d, s (1 - c^2) = w_i - c w.d.
  const double c = d[i], wd = w.dot(d), s = (w[i] - c * wd) / std::max(1 - c * c, 1e-300);
  const double r = c * s - wd;
  const double beyond = std::max(std::abs(s) - a.half_lengths[i], std::abs(r) - b.half_lengths[j]);
  if (beyond > kBoxSlack * a.half_lengths[i] && separation > 0) return false;
  p[i] = std::clamp(s, -a.half_lengths[i], a.half_lengths[i]);
  const Vec3 on_a = pose_a.to_world(p);
  manifold.normal = pose_a.rotation * n;
  manifold.add({on_a, on_a + separation * manifold.normal, separation, 1 << 24 | edges.feature});
  return true;
}

// Where an edge of a lies along an edge of b, as cards do that lean on each other: their directions
// apart are all those between the normals of two faces, n is in their middle (frame of a). False
// where the edges are not beside each other, or not as far apart as the faces.
bool lay_edges(const Box& a, const Pose& pose_a, const Box& b, const Mat3& R, const Vec3& t,
               const Vec3& n, double least, Manifold& manifold) {
  const Vec3 along_b = R.transpose() * n;
  int i, j;
  n.cwiseAbs().minCoeff(&i), along_b.cwiseAbs().minCoeff(&j);
  const FacingEdges edges(a, b, R, t, i, j, n);
  const Vec3 &p = edges.p, &q = edges.q, d = R.col(j);
  // Along the axis i of a: what both edges have beside each other.
  const double reach = b.half_lengths[j] * std::abs(d[i]);
  const double from = std::max(q[i] - reach, -a.half_lengths[i]);
  const double to = std::min(q[i] + reach, a.half_lengths[i]);
  if (std::abs(d[i]) < kFlat || from > to) return false;
  const Vec3 on_b[2] = {q + (from - q[i]) / d[i] * d, q + (to - q[i]) / d[i] * d};
  const double separations[2] = {n.dot(on_b[0] - p) - n[i] * from, n.dot(on_b[1] - p) - n[i] * to};
  if (std::min(separations[0], separations[1]) < least) return false;
  manifold.normal = pose_a.rotation * n;
  for (std::uint32_t k = 0; k < 2; ++k) {
    const Vec3 point = pose_a.to_world(on_b[k]);
    manifold.add({point - separations[k] * manifold.normal, point, separations[k],
                  1 << 25 | k << 6 | edges.feature});
  }
  return true;
}

// How far the planes across the axes of faces are apart: lanes of a's axes, and of b's. The last
// lane is below all.
struct FaceAxes {
  FaceAxes(const Relative& rel, const Vec3& h, const Vec3& g) {
    const V below{0, 0, 0, 1e300};
    V reach_a = lanes(h), reach_b = lanes(g);
    for (int i = 0; i < 3; ++i) {
      reach_a = fma(g[i], magnitude(rel.b_in_a[i]), reach_a);
      reach_b = fma(h[i], magnitude(rel.a_in_b[i]), reach_b);
    }
    a = magnitude(rel.t_a) - reach_a - below, b = magnitude(rel.t_b) - reach_b - below;
  }
  V a, b;
};

int largest(const V& v) {
  const int i = v[1] > v[0] ? 1 : 0;
  return v[2] > v[i] ? 2 : i;
}

// Axes a_i x b_j, of length l, the three j of one i at a time: l s = |t . axis| - h . |axis| - g .
// |axis in b|. Of those above `best` the largest s.
struct EdgeAxes {
  bool apart = false;  // one separates by more than the margin
  int i = -1, j = -1;
  double best;
};
EdgeAxes edge_axes(const Relative& rel, const Vec3& h, const Vec3& g, double margin, double best) {
  EdgeAxes found;
  found.best = best;
  const V g1 = {g[1], g[2], g[0], 0}, g2 = {g[2], g[0], g[1], 0};
  V size[3], square[3];
  for (int i = 0; i < 3; ++i) {
    size[i] = magnitude(rel.a_in_b[i]), square[i] = rel.a_in_b[i] * rel.a_in_b[i];
  }
  const double margin2 = margin * margin;
  for (int i = 0; i < 3; ++i) {
    const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
    const V l2 = square[i1] + square[i2];
    const V along = rel.t_a[i2] * rel.a_in_b[i1] - rel.t_a[i1] * rel.a_in_b[i2];
    const V other1 = __builtin_shufflevector(size[i], size[i], 1, 2, 0, 3);
    const V other2 = __builtin_shufflevector(size[i], size[i], 2, 0, 1, 3);
    const V s = magnitude(along) - h[i1] * size[i2] - h[i2] * size[i1] - g1 * other2 - g2 * other1;
    const auto crossing = l2 > 1e-14;  // of parallel edges the axes of faces have said all
    if (any(crossing & (s > 0) & (s * s > margin2 * l2))) {
      found.apart = true;
      return found;
    }
    // s / l > best, without the root
    const double b = found.best;
    if (!any(crossing & (magnitude(s) * s > std::abs(b) * b * l2))) continue;
    for (int j = 0; j < 3; ++j) {
      const double value = s[j] / std::sqrt(l2[j]);
      if (crossing[j] && value > found.best) found.best = value, found.i = i, found.j = j;
    }
  }
  return found;
}

}  // namespace

void box_box(const Box& a, const Pose& pose_a, const Box& b, const Pose& pose_b, double margin,
             Manifold& manifold, Cache& cache) {
  const Vec3 &h = a.half_lengths, &g = b.half_lengths;
  const Relative rel(pose_a, pose_b);
  const FaceAxes faces(rel, h, g);
  if (any(~((faces.a <= margin) & (faces.b <= margin)))) return;
  const int i = largest(faces.a), j = largest(faces.b);
  const double size = std::min(h.minCoeff(), g.minCoeff());
  const bool face_of_b = faces.b[j] > faces.a[i] + kFacePreference * size;
  const double face = face_of_b ? faces.b[j] : faces.a[i];
  const EdgeAxes edges = edge_axes(rel, h, g, margin, face + kFacePreference * size);
  if (edges.apart) return;

  Mat3 R;  // b's axes in the frame of a, in columns
  R << vec3(rel.b_in_a[0]), vec3(rel.b_in_a[1]), vec3(rel.b_in_a[2]);
  const Vec3 t = vec3(rel.t_a);
  const Vec3 n_a = std::copysign(1.0, t[i]) * Vec3::Unit(i);
  const Vec3 n_b = std::copysign(1.0, rel.t_b[j]) * R.col(j);
  bool found;
  if (edges.i >= 0) {
    Vec3 n = Vec3::Unit(edges.i).cross(R.col(edges.j)).normalized();
    if (n.dot(t) < 0) n = -n;
    found = cross_edges(a, pose_a, b, R, t, edges.i, edges.j, n, edges.best, manifold);
  } else if (std::abs(faces.a[i] - faces.b[j]) < kFacePreference * size && n_a.dot(n_b) < kFlat &&
             lay_edges(a, pose_a, b, R, t, (n_a + n_b).normalized(), face - kFacePreference * size,
                       manifold)) {
    found = true;
  } else if (!face_of_b) {
    found =
        clip_faces(a, pose_a, i, t[i] < 0 ? -1 : 1, b, R, t, margin, size, false, face, manifold);
  } else {
    found = clip_faces(b, pose_b, j, rel.t_b[j] < 0 ? 1 : -1, a, R.transpose(), -vec3(rel.t_b),
                       margin, size, true, face, manifold);
  }
  if (found) return;
  // Apart, and closest at a corner: no axis of the fifteen is the direction of the distance.
  const BoxPolytope box_a(h), box_b(g);
  convex_convex(convex(a, box_a), pose_a, convex(b, box_b), pose_b, margin, manifold, cache);
}

}  // namespace substep::rigid
