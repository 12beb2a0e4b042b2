// How mud and fluids flow: the implicit flow rule against bisection and the law of steady shear,
// the equation of state against its closed form.
#include <gtest/gtest.h>

#include <cmath>

#include "samples.h"

namespace {

using namespace substep;
using namespace substep::mpm;

template <class T>
class Flow : public testing::Test {
 public:
  static constexpr double kTolerance = sizeof(T) == 8 ? 1e-12 : 1e-5;
};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(Flow, Reals);

// K g^n + mu dt g = A by bisection.
double bisected_share(const HerschelBulkley& m, double A, double dt) {
  double low = -400, high = 400;  // ln g
  for (int k = 0; k < 200; ++k) {
    const double u = (low + high) / 2;
    const double f = m.consistency / A * std::exp(m.flow_index * u) + m.mu * dt / A * std::exp(u);
    (f > 1 ? high : low) = u;
  }
  return m.consistency / A * std::exp(m.flow_index * low);
}

TYPED_TEST(Flow, herschel_bulkley_flow_is_solved) {
  using T = TypeParam;
  HerschelBulkley m = usual<HerschelBulkley>();
  for (const double n : {0.1, 0.3, 0.6, 1.0, 1.5, 2.0}) {
    for (const double K : {1e-3, 1.0, 50.0, 1e4}) {
      for (const double dt : {1e-6, 1e-4, 1e-2}) {
        for (const double A : {1e-2, 1.0, 1e3, 1e5}) {
          m.flow_index = n, m.consistency = K;
          const double share = m.viscous_share<Vector<T>>(splat<Vector<T>>(T(A)), T(dt))[0];
          EXPECT_NEAR(share, bisected_share(m, T(A), T(dt)), 20 * TestFixture::kTolerance)
              << n << " " << K << " " << dt << " " << A;
        }
      }
    }
  }
}

// Steady simple shear: tau_xy = tau_y + K g^n, whatever the step; deviations of order (tau / mu)^2.
TYPED_TEST(Flow, herschel_bulkley_flow_curve) {
  for (const double n : {0.4, 1.0, 1.6}) {
    for (const double rate : {0.1, 1.0, 10.0}) {
      for (const double strain : {1e-3, 1e-2}) {  // of one step
        Packet<HerschelBulkley, TypeParam> mud;
        mud.material.yield_stress = 100;
        mud.material.consistency = 30;
        mud.material.flow_index = n;
        const double dt = strain / rate;
        for (double sheared = 0; sheared < 0.5; sheared += strain) {
          mud.advance(shear_rate(rate), dt);
          mud.stress(dt);
        }
        const double law = 100 + 30 * std::pow(rate, n);
        const double before = mud.own(0);
        EXPECT_NEAR(mud.stress_of()(0, 1), law,
                    (2e-4 + 4 * std::pow(law / kMu, 2)) * law + 2 * (sizeof(TypeParam) == 4));
        mud.advance(shear_rate(rate), dt);
        mud.stress(dt);
        EXPECT_NEAR((mud.own(0) - before) / dt, rate, 2e-3 * rate);  // all of the shear is plastic
      }
    }
  }
}

// Below the yield stress mud is elastic: it comes back, and never flows.
TYPED_TEST(Flow, herschel_bulkley_rests_below_yield) {
  Packet<HerschelBulkley, TypeParam> mud;
  const double strain = 0.9 * mud.material.yield_stress / kMu;
  mud.advance(shear_rate(strain), 1);
  mud.stress(1);
  EXPECT_NEAR(mud.stress_of()(0, 1), 0.9 * mud.material.yield_stress, 1);
  for (int step = 0; step < 100; ++step) mud.stress(1);
  EXPECT_NEAR(mud.stress_of()(0, 1), 0.9 * mud.material.yield_stress, 1);
  EXPECT_EQ(mud.own(0), 0);
}

// p = K/gamma (J^-gamma - 1), at its rest and its derivative K there; viscous shear eta g, and no
// stress from a rotation.
TYPED_TEST(Flow, fluid_equation_of_state) {
  for (const double gamma : {1.0, 1.4, 7.0}) {
    for (const double J : {0.9, 0.99, 1.0, 1.01, 1.3}) {
      for (const bool tension : {false, true}) {
        Packet<Fluid, TypeParam> fluid;
        const double K = fluid.material.bulk_modulus;
        fluid.material.exponent = gamma;
        fluid.material.tension = tension;
        fluid.deform(diagonal(J, 1, 1));
        fluid.stress(1e-3, shear_rate(3));
        const double p = K / gamma * (std::pow(J, -gamma) - 1);
        const Matrix3d tau = fluid.stress_of();
        const double expected = tension ? p : std::max(p, 0.0);
        EXPECT_NEAR(pressure(tau), J * expected, TestFixture::kTolerance * K);
        EXPECT_NEAR(tau(0, 1), J * fluid.material.viscosity * 3, 1e-4);
        EXPECT_NEAR(tau(0, 1), tau(1, 0), 0);
        fluid.stress(1e-3, 100 * Matrix3d::Identity());  // no viscosity of volume
        EXPECT_LT((fluid.stress_of() + J * expected * Matrix3d::Identity()).norm(),
                  2 * TestFixture::kTolerance * K);
        Matrix3d turn = shear_rate(3);
        turn(1, 0) = -3;
        fluid.stress(1e-3, turn);
        EXPECT_LT(deviator(fluid.stress_of()).norm(), TestFixture::kTolerance * K);
      }
    }
  }
}

// A gap of 5 % in volume has to close before the fluid resists again.
TYPED_TEST(Flow, fluid_remembers_the_gap) {
  Packet<Fluid, TypeParam> fluid;
  for (const double rate : {0.05, -0.04}) {
    fluid.advance(diagonal(rate, 0, 0), 1);
    fluid.stress(1);
    EXPECT_EQ(fluid.stress_of().norm(), 0);
  }
  EXPECT_NEAR(fluid.own(0), 1.05 * 0.96, 1e-6);
  fluid.advance(diagonal(-0.05, 0, 0), 1);
  fluid.stress(1);
  const double J = 1.05 * 0.96 * 0.95;
  EXPECT_NEAR(pressure(fluid.stress_of()), J * 1e5 / 7 * (std::pow(J, -7) - 1), 1);
}

}  // namespace
