#include "substep/rigid/narrow_phase.h"

#include "substep/rigid/box_box.h"
#include "substep/rigid/plane_contacts.h"
#include "substep/rigid/sphere_contacts.h"

namespace substep::rigid {
namespace {

struct Pair {
  const Pose &pose_a, &pose_b;
  double margin;
  Manifold& manifold;
  Cache& cache;

  void operator()(const Sphere& a, const Sphere& b) const {
    sphere_sphere(a, pose_a, b, pose_b, margin, manifold);
  }
  void operator()(const Sphere& a, const Plane& b) const {
    sphere_plane(a, pose_a, b, pose_b, margin, manifold);
  }
  void operator()(const Box& a, const Plane& b) const {
    box_plane(a, pose_a, b, pose_b, margin, manifold);
  }
  void operator()(const Box& a, const Box& b) const {
    box_box(a, pose_a, b, pose_b, margin, manifold, cache);
  }
};

}  // namespace

bool collide(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b, double margin,
             Manifold& manifold, Cache& cache) {
  manifold.count = 0;
  const auto pair = [&](const auto& first, const auto& second) {
    if constexpr (std::is_invocable_v<const Pair&, decltype(first), decltype(second)>) {
      Pair{pose_a, pose_b, margin, manifold, cache}(first, second);
    } else if constexpr (std::is_invocable_v<const Pair&, decltype(second), decltype(first)>) {
      Pair{pose_b, pose_a, margin, manifold, cache}(second, first);
      manifold.flip();
    }
  };
  std::visit(pair, a, b);
  return manifold.count > 0;
}

}  // namespace substep::rigid
