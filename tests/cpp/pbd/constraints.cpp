// Every constraint of the list, from its formulas alone: gradient, momentum, invariance,
// projection, degenerate points. A new constraint is enrolled by its place in
// pbd/constraints/constraint_list.h.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "substep/core/atan2.h"
#include "substep/core/random.h"
#include "substep/pbd/constraints/constraint_list.h"

namespace {

using namespace substep;
using namespace substep::pbd;

template <class T>
constexpr int kLanes = static_cast<int>(kVectorBytes / sizeof(T));

double random_number(std::uint64_t stream, std::uint64_t index) {
  return uniform2(stream, index)[0];
}

// As many constraints of one kind as a vector has lanes.
template <class Constraint, class T>
struct Sample {
  using V = Vector<T>;
  std::array<Lanes3<V>, Constraint::kPoints> x{};
  std::array<V, Constraint::kParameters> p{};
  V c{};
  std::array<Lanes3<V>, Constraint::kPoints> gradient{};

  // Points in [-1, 1]^3, parameters in [0.5, 1].
  explicit Sample(std::uint64_t seed) {
    std::uint64_t index = 0;
    for (int lane = 0; lane < kLanes<T>; ++lane) {
      for (auto& point : x) {
        for (V* coordinate : {&point.x, &point.y, &point.z}) {
          (*coordinate)[lane] = T(2 * random_number(seed, index++) - 1);
        }
      }
      for (V& parameter : p) parameter[lane] = T(0.5 + 0.5 * random_number(seed, index++));
    }
  }
  void evaluate() { Constraint::template evaluate<V>(x, p, c, gradient); }
  T residual(int lane) const {
    return Constraint::kInequality ? std::max(-c[lane], T(0)) : std::abs(c[lane]);
  }
  V square_of_gradient() const {
    V sum{};
    for (const auto& g : gradient) sum += dot(g, g);
    return sum;
  }
  bool is_finite() const {
    bool finite = true;
    for (int lane = 0; lane < kLanes<T>; ++lane) {
      finite &= std::isfinite(c[lane]);
      for (const auto& g : gradient) {
        finite &= std::isfinite(g.x[lane]) && std::isfinite(g.y[lane]) && std::isfinite(g.z[lane]);
      }
    }
    return finite;
  }
};

template <class V>
void move(Lanes3<V>& x, const Matrix3<double>& R, const Vector3<double>& shift) {
  for (int lane = 0; lane < static_cast<int>(sizeof(V) / sizeof(x.x[0])); ++lane) {
    const Vector3<double> moved = R * Vector3<double>{{x.x[lane], x.y[lane], x.z[lane]}} + shift;
    x.x[lane] = moved[0], x.y[lane] = moved[1], x.z[lane] = moved[2];
  }
}

Matrix3<double> random_rotation(std::uint64_t seed) {
  Matrix3<double> A;
  for (int k = 0; k < 9; ++k) {
    A(k / 3, k % 3) = random_number(seed, static_cast<std::uint64_t>(k)) - 0.5;
  }
  return svd3(A).U;
}

template <class Constraint>
class Constraints : public testing::Test {};
template <class List>
struct TypesOf;
template <class... Each>
struct TypesOf<ConstraintList<Each...>> {
  using Types = testing::Types<Each...>;
};
TYPED_TEST_SUITE(Constraints, TypesOf<AllConstraints>::Types);

TYPED_TEST(Constraints, GradientIsThatOfFiniteDifferences) {
  constexpr double h = 1e-5;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    Sample<TypeParam, double> s(seed);
    s.evaluate();
    for (std::size_t i = 0; i < s.x.size(); ++i) {
      const auto check = [&](auto& coordinate, const auto& slope) {
        Sample<TypeParam, double> up = s, down = s;
        coordinate(up) += h;
        coordinate(down) -= h;
        up.evaluate(), down.evaluate();
        for (int lane = 0; lane < kLanes<double>; ++lane) {
          const double size = 1 + std::sqrt(s.square_of_gradient()[lane]);
          if (size > 100) continue;  // nearly degenerate: the differences are what is wrong
          EXPECT_NEAR((up.c[lane] - down.c[lane]) / (2 * h), slope[lane], 1e-7 * size * size * size)
              << "point " << i << ", seed " << seed;
        }
      };
      auto x = [i](auto& at) -> auto& { return at.x[i].x; };
      auto y = [i](auto& at) -> auto& { return at.x[i].y; };
      auto z = [i](auto& at) -> auto& { return at.x[i].z; };
      check(x, s.gradient[i].x);
      check(y, s.gradient[i].y);
      check(z, s.gradient[i].z);
    }
  }
}

TYPED_TEST(Constraints, JoinedPointsKeepLinearAndAngularMomentum) {
  if (TypeParam::kPoints == 1) GTEST_SKIP() << "one point is joined to the world";
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    Sample<TypeParam, double> s(seed);
    s.evaluate();
    Lanes3<Vector<double>> force{}, torque{};
    for (std::size_t i = 0; i < s.x.size(); ++i) {
      force = force + s.gradient[i];
      torque = torque + cross(s.x[i], s.gradient[i]);
    }
    const Vector<double> size = s.square_of_gradient();
    for (int lane = 0; lane < kLanes<double>; ++lane) {
      const double limit = 1e-13 * (1 + std::sqrt(size[lane]));
      EXPECT_LE(std::sqrt(dot(force, force)[lane]), limit);
      EXPECT_LE(std::sqrt(dot(torque, torque)[lane]), 10 * limit);
    }
  }
}

TYPED_TEST(Constraints, JoinedPointsMayMoveAndTurnTogether) {
  if (TypeParam::kPoints == 1) GTEST_SKIP() << "one point is joined to the world";
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    Sample<TypeParam, double> s(seed);
    s.evaluate();
    Sample<TypeParam, double> moved = s;
    const Matrix3<double> R = random_rotation(1000 + seed);
    for (auto& x : moved.x) move(x, R, {{3, -2, 1}});
    moved.evaluate();
    for (int lane = 0; lane < kLanes<double>; ++lane) {
      EXPECT_NEAR(moved.c[lane], s.c[lane], 1e-12 * (1 + s.square_of_gradient()[lane]));
    }
    for (std::size_t i = 0; i < s.x.size(); ++i) {
      Lanes3<Vector<double>> turned = s.gradient[i];
      move(turned, R, {});
      const Lanes3<Vector<double>> difference = turned - moved.gradient[i];
      for (int lane = 0; lane < kLanes<double>; ++lane) {
        const double size = 1 + s.square_of_gradient()[lane];
        EXPECT_LE(std::sqrt(dot(difference, difference)[lane]), 1e-12 * size * size);
      }
    }
  }
}

// x_i += w_i dC/dx_i lambda with lambda = -C / sum w |dC/dx|^2, Newton's method for C = 0.
TYPED_TEST(Constraints, ProjectionsReachTheConstraint) {
  int reached = 0, tried = 0;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    Sample<TypeParam, double> s(seed);
    s.evaluate();
    const Sample<TypeParam, double> start = s;
    for (int iteration = 0; iteration < 40; ++iteration) {
      Vector<double> weight{};
      for (std::size_t i = 0; i < s.x.size(); ++i) {
        weight += (1.0 + static_cast<double>(i)) * dot(s.gradient[i], s.gradient[i]);
      }
      auto acts = weight > 0;
      if (TypeParam::kInequality) acts &= s.c < 0.0;
      const Vector<double> lambda = acts ? -s.c / (acts ? weight : weight + 1) : weight * 0;
      for (std::size_t i = 0; i < s.x.size(); ++i) {
        s.x[i] = s.x[i] + (lambda * (1.0 + static_cast<double>(i))) * s.gradient[i];
      }
      s.evaluate();
    }
    for (int lane = 0; lane < kLanes<double>; ++lane) {
      ++tried;
      EXPECT_LE(s.residual(lane), 0.95 * start.residual(lane) + 1e-9);
      reached += s.residual(lane) < 1e-6;
    }
  }
  // It falls, but only its balance with the volume is a shape to reach.
  if (std::is_same_v<TypeParam, NeoHookeanDeviatoric>) return;
  EXPECT_GE(reached, 0.98 * tried);
}

// Coincident points, points on a line, in a plane, next to each other, and far away.
template <class Constraint, class T>
Sample<Constraint, T> degenerate(int kind) {
  Sample<Constraint, T> s(7);
  for (std::size_t i = 0; i < s.x.size(); ++i) {
    using V = Vector<T>;
    const T k = T(i);
    Lanes3<V>& at = s.x[i];
    if (kind == 0) at = Lanes3<V>{};
    if (kind == 1) at = Lanes3<V>{V{} + k, V{}, V{}};
    if (kind == 2) at = Lanes3<V>{V{} + T(0.1) * k, V{} + T(0.3) * k, V{} - T(0.7) * k};
    if (kind == 3) at.z = V{};
    if (kind == 4 && i > 0) at = s.x[i - 1];
    if (kind == 5) at = (V{} + T(1e6)) * at;
    if (kind == 6) at = (V{} + T(1e-6)) * at;
    if (kind == 7 && i > 1) at = s.x[i % 2];
  }
  return s;
}

template <class Constraint, class T>
void check_degenerate() {
  for (int kind = 0; kind < 8; ++kind) {
    SCOPED_TRACE(kind);
    auto s = degenerate<Constraint, T>(kind);
    s.evaluate();
    EXPECT_TRUE(s.is_finite());
    // A correction by this gradient is finite, too.
    for (int lane = 0; lane < kLanes<T>; ++lane) {
      const T square = s.square_of_gradient()[lane];
      if (square == 0) continue;
      EXPECT_TRUE(std::isfinite(s.c[lane] / square * std::sqrt(square)));
    }
  }
}

TYPED_TEST(Constraints, DegeneratePointsGiveFiniteNumbers) {
  check_degenerate<TypeParam, double>();
  check_degenerate<TypeParam, float>();
}

TYPED_TEST(Constraints, CoincidentPointsHaveNoGradient) {
  auto s = degenerate<TypeParam, double>(0);
  if (TypeParam::kPoints == 1) s.p = {};  // at the target
  s.evaluate();
  for (int lane = 0; lane < kLanes<double>; ++lane) EXPECT_EQ(s.square_of_gradient()[lane], 0);
}

TYPED_TEST(Constraints, FloatAgreesWithDouble) {
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    Sample<TypeParam, float> narrow(seed);
    narrow.evaluate();
    Sample<TypeParam, double> wide(0);
    for (int lane = 0; lane < kLanes<double>; ++lane) {
      for (std::size_t i = 0; i < wide.x.size(); ++i) {
        wide.x[i].x[lane] = narrow.x[i].x[lane];
        wide.x[i].y[lane] = narrow.x[i].y[lane];
        wide.x[i].z[lane] = narrow.x[i].z[lane];
      }
      for (std::size_t i = 0; i < wide.p.size(); ++i) wide.p[i][lane] = narrow.p[i][lane];
    }
    wide.evaluate();
    for (int lane = 0; lane < kLanes<double>; ++lane) {
      const double size = 1 + wide.square_of_gradient()[lane];
      EXPECT_NEAR(narrow.c[lane], wide.c[lane], 4e-6 * size);
      for (std::size_t i = 0; i < wide.x.size(); ++i) {
        EXPECT_NEAR(narrow.gradient[i].y[lane], wide.gradient[i].y[lane], 1e-5 * size * size);
      }
    }
  }
}

TEST(DihedralBending, AngleIsThatOfTheFold) {
  using V = Vector<double>;
  for (const double fold : {-3.1, -1.0, 0.0, 1e-9, 0.5, 2.0, 3.1}) {
    std::array<Lanes3<V>, 4> x{};
    x[1].x += 2.0;
    x[2].x += 0.3, x[2].y += 1.0;  // the normal of the first triangle is z
    x[3].x += 1.7, x[3].y += -std::cos(fold), x[3].z += std::sin(fold);
    EXPECT_NEAR(DihedralBending::angle<V>(x)[0], fold, 1e-15);
    // A rest angle on the other side of pi is near.
    V c{};
    std::array<Lanes3<V>, 4> gradient;
    DihedralBending::evaluate<V>(x, {V{} - 3.1}, c, gradient);
    EXPECT_NEAR(c[0], std::remainder(fold + 3.1, 2 * std::numbers::pi), 1e-14);
  }
}

TEST(NeoHookean, RestIsABalanceOfBothConstraints) {
  // m V C dC/dx + l V C dC/dx = 0 at F = 1, with m = 1, l = 4 and a = 1 + 3/16.
  using V = Vector<double>;
  std::array<Lanes3<V>, 4> x{}, deviatoric, hydrostatic;
  x[1].x += 1.0, x[2].y += 1.0, x[3].z += 1.0;
  std::array<V, 9> inverse{};
  for (std::size_t k : {0u, 4u, 8u}) inverse[k] += 1.0;
  V c{}, d{};
  NeoHookeanDeviatoric::evaluate<V>(x, inverse, c, deviatoric);
  NeoHookeanHydrostatic::evaluate<V>(x, {V{} + 6.0, V{} + 1.1875}, d, hydrostatic);
  for (std::size_t i = 0; i < 4; ++i) {
    const auto force = c * deviatoric[i] + (4.0 * d) * hydrostatic[i];
    EXPECT_NEAR(dot(force, force)[0], 0, 1e-28);
  }
}

template <class T>
void check_atan2() {
  using V = Vector<T>;
  for (std::uint64_t index = 0; index < 20000; ++index) {
    const auto u = uniform2(3, index);
    const double radius = std::exp2(20 * (u[0] - 0.5)), angle = (2 * u[1] - 1) * std::numbers::pi;
    const T y = T(radius * std::sin(angle)), x = T(radius * std::cos(angle));
    const T got = atan2<V>(V{} + y, V{} + x)[0], expected = std::atan2(y, x);
    EXPECT_NEAR(got, expected, 3 * std::numeric_limits<T>::epsilon() * std::abs(expected));
  }
  for (const T y : {T(0), T(1), T(-1)}) {
    for (const T x : {T(0), T(1), T(-1)}) {
      EXPECT_NEAR((atan2<V>(V{} + y, V{} + x)[0]), std::atan2(y, x), 1e-6);
    }
  }
}

template <class T>
void check_log() {
  using V = Vector<T>;
  constexpr T kEps = std::numeric_limits<T>::epsilon();
  for (std::uint64_t index = 0; index < 20000; ++index) {
    const T x = T(std::exp2(40 * uniform2(4, index)[0] - 20));
    const T got = substep::log<V>(V{} + x)[0], expected = std::log(x);
    EXPECT_NEAR(got, expected, 3 * kEps * std::max(std::abs(expected), T(0.25)));
    const double a = static_cast<double>(x),
                 exact = a < 1e-4 ? a * a * (0.5 - a / 3 + a * a / 4) : a - std::log1p(a);
    EXPECT_NEAR(minus_log_one_plus<V>(V{} + x)[0], exact, (200 * kEps + 1e-10) * exact);
  }
  EXPECT_EQ(minus_log_one_plus<V>(V{})[0], 0);
}

TEST(Log, AgreesWithTheLibrary) {
  check_log<float>();
  check_log<double>();
}

TEST(Atan2, AgreesWithTheLibrary) {
  check_atan2<float>();
  check_atan2<double>();
}

}  // namespace
