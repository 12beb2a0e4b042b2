#include "substep/rigid/distance/epa.h"

#include <algorithm>

namespace substep::rigid {
namespace {

constexpr int kMaxVertices = 160, kMaxFaces = 1024;
// Fractions of the scale: of polytopes it ends exactly, what is curved is refined afterwards.
constexpr double kDepthConverged = 1e-13, kDepthConvergedCurved = 1e-10;
constexpr double kFlatFace = 1e-9, kShared = 1e-10;  // of the scale

struct Face {
  int v[3], across[3];  // across[k]: over the edge v[k], v[k + 1]
  Vec3 normal;
  double offset;  // of its plane; infinite for a sliver, which has no plane
  bool alive;
};

class Expansion {
 public:
  Expansion(const Difference& difference, const Simplex& simplex)
      : difference_(difference),
        scale_(difference.scale()),
        converged_(scale_ * (is_curved(difference) ? kDepthConvergedCurved : kDepthConverged)) {
    for (int k = 0; k < simplex.count; ++k) {
      w_[k] = simplex.w[k], x_[k] = simplex.x[k];
      ++vertices_;
    }
  }

  Penetration run() {
    if (!make_tetrahedron()) return flat();
    int closest = -1;
    while (true) {
      closest = -1;
      for (int f = 0; f < faces_; ++f) {
        if (face_[f].alive && (closest < 0 || face_[f].offset < face_[closest].offset)) closest = f;
      }
      const Face& face = face_[closest];
      if (vertices_ == kMaxVertices || faces_ + 32 > kMaxFaces) break;
      add_vertex(face.normal);
      const double progress = face.normal.dot(w_[vertices_ - 1]) - face.offset;
      if (progress <= converged_ || !expand(closest)) break;
    }
    return result(face_[closest]);
  }

 private:
  void add_vertex(const Vec3& d) {
    Vec3 y;
    w_[vertices_] = difference_.support(d, x_[vertices_], y);
    ++vertices_;
  }

  // Adds a vertex that is off what there is along d or against it.
  template <class Off>
  bool add_off(const Vec3& d, Off&& off) {
    for (const double sign : {1.0, -1.0}) {
      add_vertex(sign * d);
      if (off(w_[vertices_ - 1]) > kFlatFace * scale_) return true;
      --vertices_;
    }
    return false;
  }

  bool make_tetrahedron() {
    if (vertices_ == 1) {
      for (int i = 0; i < 3 && vertices_ == 1; ++i) {
        add_off(Vec3::Unit(i), [&](const Vec3& w) { return (w - w_[0]).norm(); });
      }
      if (vertices_ == 1) return false;
    }
    if (vertices_ == 2) {
      const Vec3 line = (w_[1] - w_[0]).normalized();
      int axis;
      line.cwiseAbs().minCoeff(&axis);
      const Vec3 p = line.cross(Vec3::Unit(axis)).normalized(), q = line.cross(p);
      for (const Vec3& d : {p, q}) {
        if (add_off(d, [&](const Vec3& w) { return (w - w_[0]).cross(line).norm(); })) break;
      }
      if (vertices_ == 2) {
        plane_ = p;
        return false;
      }
    }
    plane_ = (w_[1] - w_[0]).cross(w_[2] - w_[0]).normalized();
    if (vertices_ == 3 &&
        !add_off(plane_, [&](const Vec3& w) { return std::abs(plane_.dot(w - w_[0])); })) {
      return false;
    }
    const bool below = plane_.dot(w_[3] - w_[0]) < 0;
    const int b = below ? 1 : 2, c = 3 - b;  // vertex 3 is below the face 0 b c
    const int faces[4][3] = {{0, b, c}, {0, 3, b}, {b, 3, c}, {c, 3, 0}};
    const int across[4][3] = {{1, 2, 3}, {3, 2, 0}, {1, 3, 0}, {2, 1, 0}};
    for (int f = 0; f < 4; ++f) {
      make_face(faces[f][0], faces[f][1], faces[f][2]);
      std::copy(across[f], across[f] + 3, face_[f].across);
    }
    return true;
  }

  void make_face(int a, int b, int c) {
    Face& face = face_[faces_++];
    face.v[0] = a, face.v[1] = b, face.v[2] = c;
    face.alive = true;
    const Vec3 e = w_[b] - w_[a], f = w_[c] - w_[a], n = e.cross(f);
    const double area = n.norm();
    if (area > 1e-14 * (e.norm() * f.norm()) && area > 0) {
      face.normal = n / area;
      // The largest of the three is the one that rounding least brings inside.
      face.offset =
          std::max({face.normal.dot(w_[a]), face.normal.dot(w_[b]), face.normal.dot(w_[c])});
    } else {
      face.normal = Vec3::Zero();
      face.offset = 1e300;
    }
  }

  bool sees(const Face& face, const Vec3& w) const {
    return face.offset == 1e300 || face.normal.dot(w) - face.offset > 1e-15 * scale_;
  }

  // Replaces the faces that the last vertex sees by a fan; false where rounding leaves no horizon.
  bool expand(int seed) {
    const int apex = vertices_ - 1;
    horizon_ = 0;
    see(seed, 0, 3, w_[apex]);
    if (horizon_ < 3 || faces_ + horizon_ > kMaxFaces) return false;
    for (int k = 0; k < horizon_; ++k) {  // a loop?
      const Face &p = face_[edge_[k][0]], &q = face_[edge_[(k + 1) % horizon_][0]];
      if (p.v[edge_[k][1]] != q.v[(edge_[(k + 1) % horizon_][1] + 1) % 3]) return false;
    }
    const int first = faces_;
    for (int k = 0; k < horizon_; ++k) {
      const int beyond = edge_[k][0], edge = edge_[k][1];
      make_face(face_[beyond].v[(edge + 1) % 3], face_[beyond].v[edge], apex);
      Face& face = face_[first + k];
      face.across[0] = beyond;
      face.across[1] = first + (k + 1) % horizon_;
      face.across[2] = first + (k + horizon_ - 1) % horizon_;
      face_[beyond].across[edge] = first + k;
    }
    return true;
  }

  // Depth first with edges in order, so that the horizon comes out in order.
  void see(int f, int from, int edges, const Vec3& w) {
    face_[f].alive = false;
    for (int step = 3 - edges; step < 3; ++step) {
      const int k = (from + step) % 3, next = face_[f].across[k];
      if (!face_[next].alive) continue;
      int back = 0;
      while (back < 2 &&
             !(face_[next].across[back] == f && face_[next].v[back] == face_[f].v[(k + 1) % 3])) {
        ++back;
      }
      if (sees(face_[next], w)) {
        see(next, back, 2, w);
      } else if (horizon_ < kMaxFaces) {
        edge_[horizon_][0] = next, edge_[horizon_][1] = back;
        ++horizon_;
      }
    }
  }

  // b - a has no volume: it is parted along the normal of its plane.
  Penetration flat() const {
    Vec3 n = vertices_ == 1 ? Vec3(Vec3::UnitZ()) : plane_;
    if (n.dot(difference_.pose_b.position) < 0) n = -n;
    Vec3 x, y;
    difference_.support(-n, x, y);
    return {n, n.dot(y - x), x};
  }

  // Weights of the corners of a face for the point of its plane closest to the origin.
  Vec3 weights(const Face& face) const {
    const Vec3 &a = w_[face.v[0]], &b = w_[face.v[1]], &c = w_[face.v[2]];
    const Vec3 o = face.offset * face.normal, n = (b - a).cross(c - a);
    const double square = n.squaredNorm();
    const double wb = n.dot((o - a).cross(c - a)) / square,
                 wc = n.dot((b - a).cross(o - a)) / square;
    return {1 - wb - wc, wb, wc};
  }

  // The normal of the contact is opposite to that of the face: it is where b - a ends along -n. Of
  // the triangles that share the face of b - a, as good as equally close, the one under the origin
  // has the point of contact.
  Penetration result(const Face& closest) const {
    const Face* under = &closest;
    Vec3 best = weights(closest);
    for (int f = 0; f < faces_; ++f) {
      const Face& face = face_[f];
      if (!face.alive || face.offset > closest.offset + kShared * scale_) continue;
      const Vec3 w = weights(face);
      if (w.minCoeff() > best.minCoeff()) best = w, under = &face;
    }
    best = best.cwiseMax(0.0);
    best /= best.sum();
    const Vec3 on_a =
        best[0] * x_[under->v[0]] + best[1] * x_[under->v[1]] + best[2] * x_[under->v[2]];
    Vec3 x, y;
    const double depth = closest.normal.dot(difference_.support(closest.normal, x, y));
    return {-closest.normal, -depth, on_a};
  }

  const Difference& difference_;
  double scale_, converged_;
  int vertices_ = 0, faces_ = 0, horizon_ = 0;
  Vec3 w_[kMaxVertices], x_[kMaxVertices];
  Vec3 plane_;
  Face face_[kMaxFaces];
  int edge_[kMaxFaces][2];
};

}  // namespace

Penetration penetration(const Difference& difference, const Simplex& simplex) {
  return Expansion(difference, simplex).run();
}

}  // namespace substep::rigid
