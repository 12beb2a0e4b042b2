// Random shapes and poses for the tests of queries.
#pragma once

#include <memory>
#include <random>
#include <type_traits>
#include <variant>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid::test {

struct Random {
  explicit Random(std::uint32_t seed) : generator(seed) {}

  double number(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(generator);
  }
  Vec3 vector(double size) {
    return {number(-size, size), number(-size, size), number(-size, size)};
  }
  Vec3 direction() {
    Vec3 d = vector(1);
    while (d.norm() > 1 || d.norm() < 0.1) d = vector(1);
    return d.normalized();
  }
  Pose pose(double size) {
    const Quaternion q(number(-1, 1), number(-1, 1), number(-1, 1), number(-1, 1));
    return {vector(size), q.normalized()};
  }
  // One of a convex kind: its numbers from 0.2 to 1, or the hull of points.
  template <class S>
  static Shape one_of(Random& random) {
    if constexpr (requires { S::kName; }) {
      return S::with([&](const char*) { return random.number(0.2, 1); });
    } else {
      std::vector<Vec3> points;
      for (int k = 0; k < 14; ++k) points.push_back(random.vector(1));
      return std::make_shared<const ConvexHull>(points);
    }
  }
  // The convex kinds of the list in turn.
  Shape shape(int kind) {
    static const std::vector<Maker> kMakers = makers(std::type_identity<Shape>());
    return kMakers[usize(kind) % kMakers.size()](*this);
  }

  std::mt19937 generator;

 private:
  using Maker = Shape (*)(Random&);
  template <class... Kinds>
  static std::vector<Maker> makers(std::type_identity<std::variant<Kinds...>>) {
    std::vector<Maker> all;
    const auto add = [&]<class S>(std::type_identity<S>) {
      if constexpr (ConvexShape<S>) all.push_back(&one_of<S>);
    };
    (add(std::type_identity<Kinds>()), ...);
    return all;
  }
};

}  // namespace substep::rigid::test
