// Terms of a fluid on a block of jittered particles of two masses: what each conserves, and limits.
#include "substep/pbf/forces.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "substep/core/random.h"
#include "substep/pbf/xsph.h"

namespace substep::pbf {
namespace {

using Vec = Eigen::Vector3d;

template <class Real>
Vec vec(const Point<Real>& p) {
  return {double(p.x), double(p.y), double(p.z)};
}

template <class Real>
struct Block {
  static constexpr int kSide = 12;
  Real d = Real(0.01), h = 2 * d;
  std::vector<Point<Real>> x, v;
  std::vector<std::int32_t> fluid;
  geometry::Neighbours<Real> lists;
  int threads = 2;

  Block() {
    for (int i = 0; i < kSide * kSide * kSide; ++i) {
      const auto a = uniform2(7, 3 * i), b = uniform2(7, 3 * i + 1), c = uniform2(7, 3 * i + 2);
      const auto at = [&](int k, double jitter) { return d * Real(k + 0.3 * jitter); };
      x.push_back({at(i % kSide, a[0]), at(i / kSide % kSide, a[1]), at(i / kSide / kSide, b[0]),
                   i % 3 == 0 ? Real(1) : Real(0.25)});
      v.push_back({Real(b[1] - 0.5), Real(c[0] - 0.5), Real(c[1] - 0.5), Real(i)});
      fluid.push_back(i % 3 == 0 ? 0 : 1);
    }
    lists.sort(x, h);
    std::vector<Point<Real>> y, u;
    std::vector<std::int32_t> f;
    for (const std::int32_t i : lists.order()) {
      y.push_back(x[i]), u.push_back(v[i]), f.push_back(fluid[i]);
    }
    lists.find(y, h);
    x = y, v = u, fluid = f;
    x.push_back({Real(1e6), Real(1e6), Real(1e6), 0});
    v.push_back({0, 0, 0, 0});
  }
  Neighbourhood<Real> near() const { return {x, v, lists, h, d * d * d, 3, threads}; }
  double mass(std::size_t i) const { return 1 / double(x[i].w); }
  std::size_t size() const { return x.size() - 1; }
  Vec momentum(const std::vector<Point<Real>>& u) const {
    Vec sum(0, 0, 0);
    for (std::size_t i = 0; i < size(); ++i) sum += mass(i) * vec(u[i]);
    return sum;
  }
  Vec angular(const std::vector<Point<Real>>& u) const {
    Vec sum(0, 0, 0);
    for (std::size_t i = 0; i < size(); ++i) sum += mass(i) * vec(x[i]).cross(vec(u[i]));
    return sum;
  }
  double energy(const std::vector<Point<Real>>& u) const {
    double sum = 0;
    for (std::size_t i = 0; i < size(); ++i) sum += 0.5 * mass(i) * vec(u[i]).squaredNorm();
    return sum;
  }
  // Sum of |m v|: what sums of momentum are small beside.
  double scale() const {
    double sum = 0;
    for (std::size_t i = 0; i < size(); ++i) sum += mass(i) * vec(v[i]).norm();
    return sum;
  }
};

template <class Real>
class PbfForces : public testing::Test {
 protected:
  Block<Real> block;
  double eps = std::is_same_v<Real, float> ? 1e-6 : 1e-13;
};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(PbfForces, Reals);

TYPED_TEST(PbfForces, XsphConservesMomentumAndDamps) {
  auto& b = this->block;
  auto u = b.v;
  xsph<TypeParam>(b.near(), TypeParam(0.5), u);
  EXPECT_LT((b.momentum(u) - b.momentum(b.v)).norm(), this->eps * b.scale());
  EXPECT_LT(b.energy(u), 0.7 * b.energy(b.v));
  for (std::size_t i = 0; i < b.size(); ++i) ASSERT_EQ(u[i].w, b.v[i].w);
}

TYPED_TEST(PbfForces, ViscosityConservesBothMomentaAtAnyTolerance) {
  auto& b = this->block;
  Viscosity<TypeParam> viscosity;
  const std::vector<TypeParam> nu(b.size(), TypeParam(0.1));
  for (const double tolerance : {0.3, 1e-4}) {
    auto u = b.v;
    const auto report =
        viscosity.solve(b.near(), nu, TypeParam(0.01), TypeParam(tolerance), 500, u);
    EXPECT_TRUE(report.converged);
    EXPECT_LE(report.residual, tolerance);
    EXPECT_LT((b.momentum(u) - b.momentum(b.v)).norm(), 3 * this->eps * b.scale());
    EXPECT_LT((b.angular(u) - b.angular(b.v)).norm(), 3 * this->eps * b.scale() * 0.1);
    EXPECT_LT(b.energy(u), b.energy(b.v));
  }
}

// With nu without bounds every motion but that of a rigid body is gone, and with it nothing else.
TYPED_TEST(PbfForces, ViscosityWithoutBoundsLeavesRigidMotion) {
  auto& b = this->block;
  const Vec spin(3, -2, 1), drift(0.5, 0.2, -0.3);
  auto rigid = b.v;
  for (std::size_t i = 0; i < b.size(); ++i) {
    const Vec u = drift + spin.cross(vec(b.x[i]));
    rigid[i] = {TypeParam(u.x()), TypeParam(u.y()), TypeParam(u.z()), 0};
  }
  Viscosity<TypeParam> viscosity;
  const std::vector<TypeParam> nu{TypeParam(1e3)};
  b.v = rigid;
  auto u = b.v;
  viscosity.solve(b.near(), nu, TypeParam(0.01), TypeParam(1e-3), 20, u);
  double worst = 0;
  for (std::size_t i = 0; i < b.size(); ++i) {
    worst = std::max(worst, (vec(u[i]) - vec(rigid[i])).norm());
  }
  EXPECT_LT(worst, (std::is_same_v<TypeParam, float>) ? 2e-2 : 1e-9);
}

TYPED_TEST(PbfForces, VorticityOfARigidRotation) {
  auto& b = this->block;
  const Vec spin(3, -2, 1);
  for (std::size_t i = 0; i < b.size(); ++i) {
    const Vec u = spin.cross(vec(b.x[i]));
    b.v[i] = {TypeParam(u.x()), TypeParam(u.y()), TypeParam(u.z()), 0};
  }
  auto omega = b.v;
  vorticity<TypeParam>(b.near(), omega);
  Vec mean(0, 0, 0);
  int inside = 0;
  for (std::size_t i = 0; i < b.size(); ++i) {
    const Vec at = vec(b.x[i]) / b.d;
    if (at.minCoeff() < 2 || at.maxCoeff() > 9.3) continue;
    mean += vec(omega[i]);
    ++inside;
    EXPECT_NEAR(omega[i].w, vec(omega[i]).norm(), 1e-5);
  }
  ASSERT_GT(inside, 200);
  EXPECT_LT((mean / inside - 2 * spin).norm(), 0.05 * spin.norm());
}

TYPED_TEST(PbfForces, ConfinementConservesMomentum) {
  auto& b = this->block;
  VorticityConfinement<TypeParam> confinement;
  auto u = b.v;
  confinement.apply(b.near(), TypeParam(0.1), TypeParam(0.01), u);
  EXPECT_LT((b.momentum(u) - b.momentum(b.v)).norm(), this->eps * b.scale());
  EXPECT_GT(std::abs(b.energy(u) - b.energy(b.v)), 1e-3 * b.energy(b.v));
}

TYPED_TEST(PbfForces, SurfaceTensionConservesBothMomenta) {
  auto& b = this->block;
  SurfaceTension<TypeParam> tension;
  auto y = b.x;
  tension.displace(b.near(), 0.07, 1e-3, TypeParam(1e-6), y);
  Vec sum(0, 0, 0), torque(0, 0, 0);
  double scale = 0, inward = 0;
  const Vec centre = Vec::Constant(5.6 * double(b.d));
  for (std::size_t i = 0; i < b.size(); ++i) {
    const Vec j = b.mass(i) * (vec(y[i]) - vec(b.x[i]));
    sum += j, torque += vec(b.x[i]).cross(j), scale += j.norm();
    inward -= j.dot(vec(b.x[i]) - centre);
  }
  const double noise = std::is_same_v<TypeParam, float> ? 1e-3 : 1e-11;  // of y = x + small
  EXPECT_LT(sum.norm(), noise * scale);
  EXPECT_LT(torque.norm(), noise * scale * 0.1);
  EXPECT_GT(inward, 0);
}

TYPED_TEST(PbfForces, SameBitsForAnyNumberOfThreads) {
  ForceOptions options{.xsph = 0.1,
                       .viscosity = {0.01, 0.1},
                       .vorticity_confinement = 0.01,
                       .surface_tension = 0.07};
  std::vector<Point<TypeParam>> first_x, first_v;
  for (int threads = 1; threads <= 4; ++threads) {
    Block<TypeParam> b;
    Forces<TypeParam> forces;
    const typename Forces<TypeParam>::Rows rows{b.lists, b.fluid, b.h, b.d * b.d * b.d, 3, threads};
    forces.pull_together(options, rows, 1e-3, 1e-6, b.x, b.x);
    const auto report = forces.act_on_velocities(options, rows, b.x, 1e-3, b.v);
    EXPECT_TRUE(report.converged);
    if (threads == 1) first_x = b.x, first_v = b.v;
    ASSERT_EQ(std::memcmp(first_x.data(), b.x.data(), b.x.size() * sizeof b.x[0]), 0);
    ASSERT_EQ(std::memcmp(first_v.data(), b.v.data(), b.v.size() * sizeof b.v[0]), 0);
  }
}

}  // namespace
}  // namespace substep::pbf
