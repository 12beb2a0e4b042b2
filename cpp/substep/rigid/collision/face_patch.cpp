#include "substep/rigid/collision/face_patch.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace substep::rigid {
namespace {

constexpr std::uint32_t kFirstSide = 64;  // names of sides start here, those of corners are below

Outline outline_of_b(const Difference& difference, const Vec3& d) {
  const Pose& pose = difference.pose_b;
  Outline out = outline(difference.b, pose.rotation.transpose() * d);
  for (int k = 0; k < out.count; ++k) out.corners[k] = pose.to_world(out.corners[k]);
  return out;
}

void clip_by(const Outline& reference, const PlaneFrame& frame, double slack, Patch& patch) {
  if (reference.count == 2) {  // a line: what is along it, between its ends
    const double length = (reference.corners[1] - reference.corners[0]).norm();
    clip(patch, {1, 0, length, kFirstSide}, slack);
    clip(patch, {-1, 0, 0, kFirstSide + 1}, slack);
    return;
  }
  for (int k = 0; k < reference.count; ++k) {
    const int next = k + 1 == reference.count ? 0 : k + 1;
    const PatchCorner s = frame.corner(reference.corners[k], 0, 0);
    const PatchCorner e = frame.corner(reference.corners[next], 0, 0);
    const double d_u = e.u - s.u, d_v = e.v - s.v, length = std::hypot(d_u, d_v);
    const double n_u = d_v / length, n_v = -d_u / length;
    clip(patch, {n_u, n_v, n_u * s.u + n_v * s.v, kFirstSide + reference.names[k]}, slack);
  }
}

}  // namespace

Patch PlaneFrame::patch(const Outline& outline) const {
  Patch patch;
  patch.count = outline.count;
  for (int k = 0; k < outline.count; ++k) {
    const int before = outline.count == 2 ? k : (k == 0 ? outline.count : k) - 1;
    patch.corners[k] = corner(outline.corners[k], outline.names[before], outline.names[k]);
  }
  return patch;
}

bool face_patch(const Difference& difference, const Vec3& n, bool b_is_reference, double expected,
                double margin, double size, std::uint32_t salt, Manifold& manifold) {
  const Outline reference =
      b_is_reference ? outline_of_b(difference, -n) : outline(difference.a, n);
  const Outline incident = b_is_reference ? outline(difference.a, n) : outline_of_b(difference, -n);
  const PlaneFrame frame(reference.corners[0], b_is_reference ? Vec3(-n) : n,
                         reference.corners[1] - reference.corners[0]);
  Patch patch = frame.patch(incident);
  if (reference.count == 2) {
    for (int k = 0; k < patch.count; ++k) {
      if (std::abs(patch.corners[k].v) > kAside * size) return false;
    }
  }
  clip_by(reference, frame, kSlack * size, patch);
  double lowest = std::numeric_limits<double>::infinity();
  for (int k = 0; k < patch.count; ++k) lowest = std::min(lowest, patch.corners[k].height);
  if (!(lowest <= expected)) return false;

  const double rounding_a = difference.a.rounding, rounding_b = difference.b.rounding;
  const double rounding = rounding_a + rounding_b;
  const Reduced reduced =
      reduce(patch, margin + rounding, std::min(level(difference.a), level(difference.b)) * size);
  const std::uint32_t faces = reference.name * 65599u + incident.name * 2 + b_is_reference;
  manifold.normal = n;
  for (int k = 0; k < reduced.count; ++k) {
    const PatchCorner& corner = patch.corners[reduced.index[k]];
    const Vec3 p = frame.point(corner), foot = p - corner.height * frame.n;
    const bool cut = corner.before >= kFirstSide || corner.after >= kFirstSide;
    const std::uint32_t own = faces + (cut || b_is_reference ? salt * 2654435761u : 0);
    const std::uint32_t feature = corner_feature(corner, own) & ~kCutCorner;
    manifold.add({(b_is_reference ? p : foot) + rounding_a * n,
                  (b_is_reference ? foot : p) - rounding_b * n, corner.height - rounding,
                  cut ? feature | kCutCorner : feature});
  }
  return true;
}

}  // namespace substep::rigid
