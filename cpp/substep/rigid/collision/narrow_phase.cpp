#include "substep/rigid/collision/narrow_phase.h"

#include "substep/core/errors.h"
#include "substep/rigid/collision/box_box.h"
#include "substep/rigid/collision/capsule_contacts.h"
#include "substep/rigid/collision/convex_contacts.h"
#include "substep/rigid/collision/plane_contacts.h"
#include "substep/rigid/collision/sphere_contacts.h"
#include "substep/rigid/shapes/view.h"

namespace substep::rigid {
namespace {

// Pairs with a form of their own come first; the others are convex shapes or planes.
struct Pair {
  const Pose &pose_a, &pose_b;
  double margin;
  Manifold& manifold;
  Cache& cache;

  void operator()(const Sphere& a, const Sphere& b) const {
    sphere_sphere(a, pose_a, b, pose_b, margin, manifold);
  }
  void operator()(const Sphere& a, const Capsule& b) const {
    sphere_capsule(a, pose_a, b, pose_b, margin, manifold);
  }
  void operator()(const Sphere& a, const Box& b) const {
    sphere_box(a, pose_a, b, pose_b, margin, manifold);
  }
  void operator()(const Capsule& a, const Capsule& b) const {
    if (!capsule_capsule(a, pose_a, b, pose_b, margin, manifold)) any(a, b);
  }
  void operator()(const Capsule& a, const Box& b) const {
    if (!capsule_box(a, pose_a, b, pose_b, margin, manifold)) any(a, b);
  }
  void operator()(const Capsule& a, const Sphere& b) const { flip(a, b); }
  void operator()(const Box& a, const Sphere& b) const { flip(a, b); }
  void operator()(const Box& a, const Capsule& b) const { flip(a, b); }
  void operator()(const Box& a, const Box& b) const {
    box_box(a, pose_a, b, pose_b, margin, manifold, cache);
  }
  void operator()(const Sphere& a, const Plane& b) const {
    sphere_plane(a, pose_a, b, pose_b, margin, manifold);
  }
  void operator()(const Capsule& a, const Plane& b) const {
    capsule_plane(a, pose_a, b, pose_b, margin, manifold);
  }
  void operator()(const Box& a, const Plane& b) const {
    box_plane(a, pose_a, b, pose_b, margin, manifold);
  }
  template <class A, class B>
  void operator()(const A& a, const B& b) const {
    if constexpr (ConvexShape<A> && ConvexShape<B>) {
      any(a, b);
    } else if constexpr (ConvexShape<A> && std::is_same_v<B, Plane>) {
      convex_plane(View<A>(a).convex, pose_a, b, pose_b, margin, manifold);
    } else if constexpr (ConvexShape<B> && std::is_same_v<A, Plane>) {
      flip(a, b);
    } else {
      throw InputError("collide() takes convex shapes, or one and a plane");
    }
  }

  template <class A, class B>
  void any(const A& a, const B& b) const {
    const View<A> view_a(a);
    const View<B> view_b(b);
    convex_convex(view_a.convex, pose_a, view_b.convex, pose_b, margin, manifold, cache);
  }
  template <class A, class B>
  void flip(const A& a, const B& b) const {
    Pair{pose_b, pose_a, margin, manifold, cache}(b, a);
    manifold.flip();
  }
};

}  // namespace

bool collide(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b, double margin,
             Manifold& manifold, Cache& cache) {
  manifold.count = 0;
  std::visit(Pair{pose_a, pose_b, margin, manifold, cache}, a, b);
  return manifold.count > 0;
}

}  // namespace substep::rigid
