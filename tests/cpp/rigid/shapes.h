// Random shapes and poses for the tests of queries.
#pragma once

#include <random>
#include <vector>

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
  // Sphere, box, capsule, cylinder, hull in turn.
  Shape shape(int kind) {
    switch (kind % 5) {
      case 0:
        return Sphere{number(0.2, 1)};
      case 1:
        return Box{{number(0.2, 1), number(0.2, 1), number(0.2, 1)}};
      case 2:
        return Capsule{number(0.2, 0.6), number(0.2, 1)};
      case 3:
        return Cylinder{number(0.2, 1), number(0.2, 1)};
      default: {
        std::vector<Vec3> points;
        for (int k = 0; k < 14; ++k) points.push_back(vector(1));
        return std::make_shared<const ConvexHull>(points);
      }
    }
  }

  std::mt19937 generator;
};

}  // namespace substep::rigid::test
