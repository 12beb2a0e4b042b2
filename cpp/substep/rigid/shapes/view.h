// Shapes as convex ones, and what such a view stands on.
#pragma once

#include "substep/rigid/shapes/convex.h"

namespace substep::rigid {

template <class S>
struct View {
  explicit View(const S& shape) : convex(rigid::convex(shape)) {}
  Convex convex;
};
template <>
struct View<Box> {
  explicit View(const Box& box) : arrays(box.half_lengths), convex(rigid::convex(box, arrays)) {}
  View(const View&) = delete;
  BoxPolytope arrays;
  Convex convex;
};
template <>
struct View<std::shared_ptr<const ConvexHull>> {
  explicit View(const std::shared_ptr<const ConvexHull>& hull) : convex(rigid::convex(*hull)) {}
  Convex convex;
};

// Whether a shape, or a reference to one, is convex and bounded.
template <class S>
inline constexpr bool kConvex =
    !std::is_same_v<std::remove_cvref_t<S>, Plane> &&
    !std::is_same_v<std::remove_cvref_t<S>, std::shared_ptr<const TriangleMesh>>;

}  // namespace substep::rigid
