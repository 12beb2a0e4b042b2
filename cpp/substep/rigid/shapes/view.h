// Shapes as convex ones, and what such a view stands on.
#pragma once

#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

template <class S>
struct View {
  explicit View(const S& shape) : convex(rigid::convex(shape_of(shape))) {}
  Convex convex;
};
template <>
struct View<Box> {
  explicit View(const Box& box) : arrays(box.half_lengths), convex(rigid::convex(box, arrays)) {}
  View(const View&) = delete;
  BoxPolytope arrays;
  Convex convex;
};

}  // namespace substep::rigid
