#include "substep/rigid/collision/contact_patch.h"

#include <algorithm>

namespace substep::rigid {
namespace {

// By what fraction a later corner must be better than an earlier one, so that rounding does not
// choose; how far off a line, as a fraction of its length, a corner is not of it; and which part of
// `level` is no difference in depth.
constexpr double kEqual = 1e-6, kOffLine = 1e-9, kSameDepth = 1e-3;

}  // namespace

void clip(Patch& patch, const PatchSide& side, double slack) {
  const int n = patch.count;
  double beyond[2 * kMaxCorners];
  bool cut = false;
  for (int k = 0; k < n; ++k) {
    const PatchCorner& c = patch.corners[k];
    beyond[k] = side.n_u * c.u + side.n_v * c.v - side.offset;
    cut |= beyond[k] > slack;
  }
  if (!cut) return;
  const auto crossing = [&](int i, int j, std::uint32_t before,
                            std::uint32_t after) -> PatchCorner {
    const PatchCorner &a = patch.corners[i], &b = patch.corners[j];
    const double t = beyond[i] / (beyond[i] - beyond[j]);
    return {a.u + t * (b.u - a.u), a.v + t * (b.v - a.v), a.height + t * (b.height - a.height),
            before, after};
  };
  if (n <= 2) {  // a segment keeps the end that is inside
    const int out = beyond[0] > 0 ? 0 : 1;
    if (n == 1 || beyond[1 - out] > 0) {
      patch.count = 0;
    } else {
      patch.corners[out] = crossing(out, 1 - out, patch.corners[out].before, side.edge);
    }
    return;
  }
  // A convex polygon leaves by one edge and comes back by another: the corners kept are one run,
  // from the first one after a cut one.
  int first = 0;
  while (first < n && !(beyond[first] <= 0 && beyond[first == 0 ? n - 1 : first - 1] > 0)) ++first;
  if (first == n) {  // all of it
    patch.count = 0;
    return;
  }
  PatchCorner kept[2 * kMaxCorners];
  int count = 0, k = first;
  const int outside = first == 0 ? n - 1 : first - 1;
  kept[count++] = crossing(outside, first, side.edge, patch.corners[outside].after);
  while (beyond[k] <= 0) {
    kept[count++] = patch.corners[k];
    k = k + 1 == n ? 0 : k + 1;
  }
  const int last = k == 0 ? n - 1 : k - 1;
  kept[count++] = crossing(last, k, patch.corners[last].after, side.edge);
  patch.count = count;
  std::copy(kept, kept + count, patch.corners);
}

Reduced reduce(const Patch& patch, double margin, double level) {
  Reduced all;
  int candidates[2 * kMaxCorners], count = 0;
  for (int k = 0; k < patch.count; ++k) {
    if (patch.corners[k].height <= margin) candidates[count++] = k;
  }
  if (count <= 4) {
    all.count = count;
    std::copy(candidates, candidates + count, all.index);
    return all;
  }
  const PatchCorner* c = patch.corners;
  // Of the deepest the one farthest in a direction that no box is likely to be aligned with, so
  // that rounding does not choose.
  double deepest = margin, highest = c[candidates[0]].height;
  for (int i = 0; i < count; ++i) {
    deepest = std::min(deepest, c[candidates[i]].height);
    highest = std::max(highest, c[candidates[i]].height);
  }
  const double as_deep = highest - deepest <= level ? level : kSameDepth * level;
  int first = -1;
  const auto along = [&](int k) { return c[k].u + 0.37 * c[k].v; };
  for (int i = 0; i < count; ++i) {
    const int k = candidates[i];
    if (c[k].height <= deepest + as_deep && (first < 0 || along(k) > along(first))) first = k;
  }
  // The farthest from it, then on either side of the line through both the farthest from that.
  int second = first;
  double far = -1;
  for (int i = 0; i < count; ++i) {
    const int k = candidates[i];
    const double du = c[k].u - c[first].u, dv = c[k].v - c[first].v, d = du * du + dv * dv;
    if (d > far * (1 + kEqual)) far = d, second = k;
  }
  int left = -1, right = -1;
  double most = kOffLine * far, least = -kOffLine * far;
  for (int i = 0; i < count; ++i) {
    const int k = candidates[i];
    const double area = (c[second].u - c[first].u) * (c[k].v - c[first].v) -
                        (c[second].v - c[first].v) * (c[k].u - c[first].u);
    if (area > most * (1 + kEqual)) most = area, left = k;
    if (area < least * (1 + kEqual)) least = area, right = k;
  }
  all.index[all.count++] = first;
  if (left >= 0) all.index[all.count++] = left;
  if (second != first) all.index[all.count++] = second;
  if (right >= 0) all.index[all.count++] = right;
  return all;
}

}  // namespace substep::rigid
