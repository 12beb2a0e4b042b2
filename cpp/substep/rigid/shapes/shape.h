// What a convex shape is: its numbers, and all that the method asks of it. One header each;
// shapes.h lists them, and everything else visits that list.
//
// struct SomeShape {
//   static constexpr const char* kName;  // of the kind, as Python has it
//   double radius, ...;                  // its numbers, lengths in m; the frame is its own
//   template <class Numbers>             // of(name): from Python
//   static SomeShape with(const Numbers& of);
//   void check(const Expect& expect) const;         // InputError: a number is out of range
//   Vec3 support(const Vec3& d) const;              // the point farthest along d, of any length
//                                                   // (not 0); on a face or an edge: any of it
//   Ball inner_ball() const;                        // a ball that it holds, in its middle
//   double outer_radius(const Pose& local) const;   // the largest distance of a point of it from
//                                                   // the origin of the frame that `local` is in
//   MassMoments moments(double density) const;      // of numbers that check() has let pass
//
//   // These may be missing; they then come from the support point.
//   Bounds bounds(const Pose& pose) const;             // the smallest box along the axes
//   std::optional<RayHit> cast(const Ray& ray) const;  // in the frame of the shape
//   Convex convex() const;  // a core with rounding about it, where that is one of Convex::Core
// };
//
// It meets all others by GJK and EPA (distance/) and by the faces that it turns to them, which its
// support points tell (collision/outline.cpp). A pair with a form of its own stands in
// collision/narrow_phase.cpp.
#pragma once

#include <concepts>
#include <memory>
#include <string>

#include "substep/rigid/shapes/convex.h"
#include "substep/rigid/shapes/ray.h"

namespace substep::rigid {

struct Bounds {
  Vec3 low, high;
};
inline bool apart(const Bounds& p, const Bounds& q) {  // without branches
  bool apart = false;
  for (int i = 0; i < 3; ++i) apart |= (p.low[i] > q.high[i]) | (q.low[i] > p.high[i]);
  return apart;
}

struct Ball {
  Vec3 centre = Vec3::Zero();
  double radius;
};

struct MassMoments {
  double mass = 0;
  Vec3 centre = Vec3::Zero();
  Mat3 inertia = Mat3::Zero();  // about the centre, along the axes of the frame

  // About the origin, of a solid that is alike on both sides of each plane of the frame.
  static MassMoments centred(double mass, double x, double y, double z) {
    return {mass, Vec3::Zero(), Vec3(x, y, z).asDiagonal()};
  }
};

// What numbers must fulfil; `where` begins the message of the InputError.
struct Expect {
  std::string where;
  void positive(const char* name, double value) const;  // and finite
};

// Hulls and meshes are shared.
template <class S>
const S& shape_of(const S& shape) {
  return shape;
}
template <class S>
const S& shape_of(const std::shared_ptr<const S>& shape) {
  return *shape;
}

// Whether a shape, or a reference to one, is convex and bounded.
template <class S>
concept ConvexShape =
    requires(const std::remove_cvref_t<S>& shape, const Vec3& d, const Pose& pose) {
      { shape_of(shape).support(d) } -> std::convertible_to<Vec3>;
      { shape_of(shape).inner_ball() } -> std::same_as<Ball>;
      { shape_of(shape).outer_radius(pose) } -> std::same_as<double>;
      { shape_of(shape).moments(1.0) } -> std::same_as<MassMoments>;
    };

template <class S>
Bounds bounds_by_support(const S& shape, const Pose& pose) {
  Bounds box;
  for (int i = 0; i < 3; ++i) {
    const Vec3 d = pose.rotation.row(i);
    box.low[i] = pose.to_world(shape.support(-d))[i];
    box.high[i] = pose.to_world(shape.support(d))[i];
  }
  return box;
}

// A shape as what the algorithms take that need no more than a support function.
template <class S>
Convex convex_by_support(const S& shape) {
  return {.core = Convex::Core::other,
          .shape = &shape,
          .support_of_shape =
              [](const void* self, const Vec3& d) {
                return static_cast<const S*>(self)->support(d.isZero(0) ? Vec3(Vec3::UnitZ()) : d);
              },
          .polytope = {},
          .centre = shape.inner_ball().centre,
          .size = shape.inner_ball().radius,
          .extent = shape.outer_radius(Pose())};
}
template <class S>
Convex convex(const S& shape) {
  if constexpr (requires { shape.convex(); }) {
    return shape.convex();
  } else {
    return convex_by_support(shape);
  }
}

}  // namespace substep::rigid
