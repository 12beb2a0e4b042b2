#include "substep/rigid/distance/gjk.h"

#include <algorithm>
#include <limits>

namespace substep::rigid {
namespace {

constexpr double kTouching = 1e-10, kGapConverged = 1e-14, kFlatSimplex = 1e-8,
                 kRoundingOfVolume = 1e-14;
constexpr int kMaxIterations = 100;

// Keeps the corners k with weights; all indices ascending.
void keep(Simplex& s, std::initializer_list<int> corners, std::initializer_list<double> weights) {
  int to = 0;
  const double* weight = weights.begin();
  for (const int k : corners) {
    if (to != k) s.w[to] = s.w[k], s.x[to] = s.x[k], s.y[to] = s.y[k];
    s.weight[to++] = *weight++;
  }
  s.count = to;
}

// The part of a segment or triangle closest to 0 as weights (Ericson, "Real-time collision
// detection", 2005, sections 5.1.2 and 5.1.5).
struct Weights {
  double a = 0, b = 0, c = 0;
};
Weights closest_of_segment(const Vec3& p, const Vec3& q) {
  const Vec3 d = q - p;
  const double along = -p.dot(d), square = d.squaredNorm();
  if (along <= 0) return {1, 0, 0};
  if (along >= square) return {0, 1, 0};
  const double t = along / square;
  return {1 - t, t, 0};
}
Weights closest_of_triangle(const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a;
  const double d1 = -ab.dot(a), d2 = -ac.dot(a);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  const double d3 = -ab.dot(b), d4 = -ac.dot(b);
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  const double d5 = -ab.dot(c), d6 = -ac.dot(c);
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  // Areas by cross products, whose differences do not cancel as those of d1 .. d6 do.
  const Vec3 n = ab.cross(ac);
  const double vc = n.dot(a.cross(b)), va = n.dot(b.cross(c)), vb = n.dot(c.cross(a));
  if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) return {1 - d1 / (d1 - d3), d1 / (d1 - d3), 0};
  if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 > d6) return {1 - d2 / (d2 - d6), 0, d2 / (d2 - d6)};
  const double e1 = d4 - d3, e2 = d5 - d6;
  if (va <= 0 && e1 >= 0 && e2 >= 0 && e1 + e2 > 0) {
    return {0, 1 - e1 / (e1 + e2), e1 / (e1 + e2)};
  }
  const double sum = va + vb + vc;
  if (!(sum > 0)) {  // no triangle: the closest of its sides
    const Weights sides[3] = {closest_of_segment(a, b), closest_of_segment(b, c),
                              closest_of_segment(c, a)};
    const Weights all[3] = {
        {sides[0].a, sides[0].b, 0}, {0, sides[1].a, sides[1].b}, {sides[2].b, 0, sides[2].a}};
    const Weights* best = all;
    double least = 1e300;
    for (const Weights& w : all) {
      const double square = (w.a * a + w.b * b + w.c * c).squaredNorm();
      if (square < least) least = square, best = &w;
    }
    return *best;
  }
  return {va / sum, vb / sum, vc / sum};
}

void keep_triangle(Simplex& s, int i, int j, int k, const Weights& t) {
  if (t.a > 0 && t.b > 0 && t.c > 0) {
    keep(s, {i, j, k}, {t.a, t.b, t.c});
  } else if (t.a > 0 && t.b > 0) {
    keep(s, {i, j}, {t.a, t.b});
  } else if (t.a > 0 && t.c > 0) {
    keep(s, {i, k}, {t.a, t.c});
  } else if (t.b > 0 && t.c > 0) {
    keep(s, {j, k}, {t.b, t.c});
  } else {
    keep(s, {t.a > 0 ? i : t.b > 0 ? j : k}, {1});
  }
}

// Reduces the simplex to the part that is closest to 0; four points are left where 0 is inside.
void reduce_simplex(Simplex& s) {
  if (s.count == 1) {
    s.weight[0] = 1;
  } else if (s.count == 2) {
    const Weights t = closest_of_segment(s.w[0], s.w[1]);
    if (t.a > 0 && t.b > 0) {
      keep(s, {0, 1}, {t.a, t.b});
    } else {
      keep(s, {t.a > 0 ? 0 : 1}, {1});
    }
  } else if (s.count == 3) {
    keep_triangle(s, 0, 1, 2, closest_of_triangle(s.w[0], s.w[1], s.w[2]));
  } else {
    // Each face and the corner opposite to it: 0 is outside where they are on different sides. Of a
    // tetrahedron so flat that the sides are not known, all faces count.
    static constexpr int kFaces[4][4] = {{0, 1, 2, 3}, {0, 1, 3, 2}, {0, 2, 3, 1}, {1, 2, 3, 0}};
    double largest = 0, least = 1e300;
    for (const Vec3& w : s.w) largest = std::max(largest, w.norm());
    const double rounding = kRoundingOfVolume * largest * largest * largest;
    int best = -1;
    Weights best_weights;
    for (int f = 0; f < 4; ++f) {
      const Vec3 &a = s.w[kFaces[f][0]], &b = s.w[kFaces[f][1]], &c = s.w[kFaces[f][2]];
      const Vec3 n = (b - a).cross(c - a);
      const Vec3 d = s.w[kFaces[f][3]] - a;
      const double inner = n.dot(d), origin = -n.dot(a);
      const bool flat = std::abs(inner) <= std::max(rounding, kFlatSimplex * n.norm() * d.norm());
      if (!flat && inner * origin > 0) continue;
      const Weights t = closest_of_triangle(a, b, c);
      const double square = (t.a * a + t.b * b + t.c * c).squaredNorm();
      if (square < least) least = square, best = f, best_weights = t;
    }
    if (best >= 0) {
      keep_triangle(s, kFaces[best][0], kFaces[best][1], kFaces[best][2], best_weights);
    }
  }
}

}  // namespace

Vec3 Simplex::closest() const {
  Vec3 v = Vec3::Zero();
  for (int k = 0; k < count; ++k) v += weight[k] * w[k];
  return v;
}
Vec3 Simplex::on_a() const {
  Vec3 p = Vec3::Zero();
  for (int k = 0; k < count; ++k) p += weight[k] * x[k];
  return p;
}

Distance distance(const Difference& difference, const Vec3& start, double enough) {
  const double touching = kTouching * difference.scale();
  Distance result{0, Vec3::Zero(), {}};
  Simplex& simplex = result.simplex;
  simplex.w[0] = difference.support(-start, simplex.x[0], simplex.y[0]);
  simplex.weight[0] = 1;
  simplex.count = 1;
  Vec3 v = simplex.w[0];
  double square = v.squaredNorm();
  if (!(square < 1e300)) {  // farther apart than there are numbers for, or nowhere
    result.value = std::numeric_limits<double>::infinity();
    return result;
  }
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    if (square <= touching * touching) return result;
    const double length = std::sqrt(square);
    const int k = simplex.count;
    simplex.w[k] = difference.support(-v, simplex.x[k], simplex.y[k]);
    const double lower = v.dot(simplex.w[k]);  // the distance is at least lower / length
    if (lower > enough * length) {
      result.value = lower / length;
      result.normal = v / length;
      return result;
    }
    bool known = false;
    for (int i = 0; i < k; ++i) known |= simplex.w[i] == simplex.w[k];
    if (known || square - lower <= kGapConverged * square + 1e-3 * touching * length) break;
    const Simplex before = simplex;
    ++simplex.count;
    reduce_simplex(simplex);
    if (simplex.count == 4) return result;
    const Vec3 next = simplex.closest();
    const double next_square = next.squaredNorm();
    if (!(next_square < square)) {  // rounding: no better than before
      simplex = before;
      break;
    }
    v = next;
    square = next_square;
  }
  result.value = std::sqrt(square);
  result.normal = v / result.value;
  return result;
}

}  // namespace substep::rigid
