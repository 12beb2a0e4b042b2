// What holds for every kind of convex shape that shapes.h lists, whichever these are.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "shapes.h"
#include "substep/core/errors.h"
#include "substep/rigid/collision/narrow_phase.h"
#include "substep/rigid/distance/ray_cast.h"
#include "substep/rigid/distance/shape_distance.h"
#include "substep/rigid/shapes/mass_properties.h"
#include "substep/rigid/shapes/view.h"

namespace {

using namespace substep::rigid;
using test::Random;

template <class V>
struct KindsOf;
template <class... Kinds>
struct KindsOf<std::variant<Kinds...>> {
  using Types = testing::Types<Kinds...>;
};
struct Names {
  template <class S>
  static std::string GetName(int) {
    if constexpr (requires { S::kName; }) {
      return S::kName;
    } else {
      return ConvexShape<S> ? "hull" : "mesh";
    }
  }
};

template <class S>
class EveryShape : public testing::Test {
 protected:
  void SetUp() override {
    if (!ConvexShape<S>) GTEST_SKIP() << "ground";
  }
};
TYPED_TEST_SUITE(EveryShape, KindsOf<Shape>::Types, Names);

// Body of a test of a shape `s` that is drawn many times over.
template <class S, class Check>
void each(int count, Check&& check) {
  if constexpr (ConvexShape<S>) {
    Random random(11);
    for (int k = 0; k < count; ++k) {
      SCOPED_TRACE(k);
      const Shape shape = Random::one_of<S>(random);
      check(random, shape, shape_of(std::get<S>(shape)));
    }
  }
}

// How far a point is beyond the planes that touch the shape, of many.
template <class S>
double beyond(const S& shape, const Vec3& p, Random& random) {
  double most = -std::numeric_limits<double>::infinity();
  for (int k = 0; k < 300; ++k) {
    const Vec3 d = random.direction();
    most = std::max(most, d.dot(p - shape.support(d)));
  }
  return most;
}

TYPED_TEST(EveryShape, SupportPointIsOfTheShapeAndFarthest) {
  each<TypeParam>(20, [](Random& random, const Shape&, const auto& s) {
    for (int k = 0; k < 50; ++k) {
      const Vec3 d = random.direction(), x = s.support(d);
      EXPECT_LT(beyond(s, x, random), 1e-12);
      EXPECT_NEAR(d.dot(x), d.dot(s.support(1e3 * d)), 1e-12);
    }
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(s.support(Vec3::Unit(i)).allFinite());
  });
}

TYPED_TEST(EveryShape, BoundsAreTight) {
  each<TypeParam>(50, [](Random& random, const Shape& shape, const auto& s) {
    const Pose pose = random.pose(2);
    const Bounds box = bounds(shape, pose), expected = bounds_by_support(s, pose);
    EXPECT_LT((box.low - expected.low).norm(), 1e-12);
    EXPECT_LT((box.high - expected.high).norm(), 1e-12);
  });
}

TYPED_TEST(EveryShape, BallsInsideAndAbout) {
  each<TypeParam>(20, [](Random& random, const Shape& shape, const auto& s) {
    const Ball inner = inner_ball(shape);
    const Pose local = random.pose(1);
    EXPECT_GT(inner.radius, 0);
    double most = 0;
    for (int k = 0; k < 300; ++k) {
      Vec3 d = random.direction();
      EXPECT_GE(d.dot(s.support(d) - inner.centre), inner.radius - 1e-12);
      for (int j = 0; j < 50; ++j) d = local.rotation.transpose() * local.to_world(s.support(d));
      most = std::max(most, d.norm());
    }
    EXPECT_NEAR(most, outer_radius(shape, local), 1e-6);
  });
}

// Of the hull of very many of its points, which lies within.
TYPED_TEST(EveryShape, MomentsAreThoseOfItsPoints) {
  each<TypeParam>(5, [](Random& random, const Shape& shape, const auto& s) {
    std::vector<Vec3> points;
    for (int k = 0; k < 4000; ++k) points.push_back(s.support(random.direction()));
    const MassMoments own = moments(shape, 700),
                      inside = moments(std::make_shared<const ConvexHull>(points), 700);
    EXPECT_NEAR(inside.mass / own.mass, 0.995, 0.0051);
    const double size = std::sqrt(own.inertia.trace() / own.mass);
    EXPECT_LT((inside.centre - own.centre).norm(), 1e-2 * size);
    EXPECT_LT((inside.inertia - own.inertia).norm(), 0.02 * own.inertia.norm());
  });
}

TYPED_TEST(EveryShape, RaysMeetTheSurface) {
  int hits = 0, misses = 0;
  each<TypeParam>(200, [&](Random& random, const Shape& shape, const auto& s) {
    const Pose pose = random.pose(2);
    const Vec3 from = random.vector(4), to = pose.position + random.vector(1);
    const Ray ray{from, (to - from).normalized()};
    const auto hit = ray_cast(shape, pose, ray);
    const Ray local{pose.to_local(from), pose.rotation.transpose() * ray.direction};
    const auto by_support = cast_by_support(View(std::get<TypeParam>(shape)).convex, local);
    ASSERT_EQ(hit.has_value(), by_support.has_value());
    if (!hit) {
      ++misses;
      return;
    }
    ++hits;
    EXPECT_NEAR(hit->distance, by_support->distance, 1e-7);
    const Vec3 n = pose.rotation.transpose() * hit->normal, at = local.at(hit->distance);
    EXPECT_NEAR(n.norm(), 1, 1e-12);
    EXPECT_LT(n.dot(local.direction), 0);
    EXPECT_NEAR(n.dot(at - s.support(n)), 0, 1e-9);
    EXPECT_LT(beyond(s, at, random), 1e-8);
  });
  if constexpr (ConvexShape<TypeParam>) {
    EXPECT_GT(hits, 20);
    EXPECT_GT(misses, 20);
  }
}

// Against all other kinds: the normal separates them as well as any, up to what a face is preferred
// by, and the points are of both.
TYPED_TEST(EveryShape, MeetsEveryOther) {
  int apart = 0, deep = 0;
  each<TypeParam>(200, [&](Random& random, const Shape& shape, const auto& s) {
    static int turn = 0;
    const Shape other = random.shape(turn++);
    const Pose here = random.pose(1), there = random.pose(2);
    const auto contact = [&](const auto& t) {
      if constexpr (ConvexShape<decltype(t)>) {
        const auto& o = shape_of(t);
        Manifold manifold;
        Cache cache;
        ASSERT_TRUE(collide(shape, here, other, there, 100, manifold, cache));
        const Vec3 n = manifold.normal;
        const auto separation = [&](const Vec3& m) {
          return m.dot(there.to_world(o.support(-(there.rotation.transpose() * m))) -
                       here.to_world(s.support(here.rotation.transpose() * m)));
        };
        EXPECT_NEAR(n.norm(), 1, 1e-12);
        const double expected = shape_distance(shape, here, other, there).value;
        constexpr double kPreference = 2.1e-2;
        (expected > 0 ? apart : deep) += 1;
        if (expected > 0) {
          EXPECT_GT(separation(n), expected - kPreference);
        }
        for (int k = 0; k < 300; ++k) {
          EXPECT_GT(separation(n) + kPreference, separation(random.direction()));
        }
        double least = 1e9;
        for (int k = 0; k < manifold.count; ++k) {
          const ContactPoint& p = manifold.points[k];
          least = std::min(least, p.separation);
          EXPECT_LT(beyond(s, here.to_local(p.on_a), random), 1e-3);
          EXPECT_LT(beyond(o, there.to_local(p.on_b), random), 1e-3);
        }
        EXPECT_NEAR(least, separation(n), 2 * kPreference);
      }
    };
    std::visit(contact, other);
  });
  if constexpr (ConvexShape<TypeParam>) {
    EXPECT_GT(apart, 20);
    EXPECT_GT(deep, 20);
  }
}

TYPED_TEST(EveryShape, RefusesNumbersOutOfRange) {
  if constexpr (ConvexShape<TypeParam> && requires { TypeParam::kName; }) {
    std::map<std::string, double> numbers;
    TypeParam::with([&](const char* name) { return numbers[name] = 0.5; });
    EXPECT_NO_THROW(check_shape(make_shape(TypeParam::kName, numbers), ""));
    for (const auto& [name, value] : numbers) {
      for (const double bad : {0.0, -1.0, std::nan(""), HUGE_VAL}) {
        auto wrong = numbers;
        wrong[name] = bad;
        const Shape shape = make_shape(TypeParam::kName, wrong);
        EXPECT_THROW(check_shape(shape, ""), substep::InputError) << name << ' ' << bad;
        EXPECT_THROW(moments(shape, 1), substep::InputError) << name << ' ' << bad;
      }
      auto without = numbers;
      without.erase(name);
      EXPECT_THROW(make_shape(TypeParam::kName, without), substep::InputError) << name;
    }
  }
  EXPECT_THROW(make_shape("teapot", {}), substep::InputError);
}

}  // namespace
