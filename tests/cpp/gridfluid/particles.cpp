// The particles of a liquid on a grid: sorting, transfers both ways against the generic ones,
// paths, extrapolation, density and surface.
#include "substep/gridfluid/particles/particles.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <map>
#include <numbers>
#include <random>
#include <vector>

#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/particles/density.h"
#include "substep/gridfluid/particles/extrapolate.h"
#include "substep/gridfluid/particles/move.h"
#include "substep/gridfluid/particles/surface.h"
#include "substep/gridfluid/particles/transfer_to_grid.h"
#include "substep/transfer/apic.h"

namespace substep::gridfluid {
namespace {

template <class Real_, int D_>
struct Case {
  using Real = Real_;
  static constexpr int D = D_;
};

// Fields of faces.
template <class Real, int D>
struct Field {
  explicit Field(const Layout<D>& layout) {
    for (auto& numbers : data) numbers.assign(usize(layout.size), 0);
  }
  Faces<Real, D> faces() {
    Faces<Real, D> result;
    for (std::size_t c = 0; c < D; ++c) result[c] = data[c].data();
    return result;
  }
  ConstFaces<Real, D> read() const {
    ConstFaces<Real, D> result;
    for (std::size_t c = 0; c < D; ++c) result[c] = data[c].data();
    return result;
  }
  std::array<std::vector<Real>, D> data;
};

// f(component, index, position of the face) for all faces, ghosts included.
template <int D, class F>
void for_faces(const Layout<D>& layout, const F& f) {
  std::array<int, D> i;
  const auto across = [&](const auto& self, int d) -> void {
    for (i[usize(d)] = -1; i[usize(d)] <= layout.cells[usize(d)]; ++i[usize(d)]) {
      if (d + 1 < D) {
        self(self, d + 1);
        continue;
      }
      for (int c = 0; c < D; ++c) {
        std::array<double, D> x;
        for (int a = 0; a < D; ++a) x[usize(a)] = i[usize(a)] + (a == c ? 0 : 0.5);
        f(c, layout.index(i), x);
      }
    }
  };
  across(across, 0);
}

template <class Case_>
struct Scene {
  using Real = typename Case_::Real;
  static constexpr int D = Case_::D;
  static constexpr double kEps = std::is_same_v<Real, float> ? 1e-6 : 1e-14;
  using Rows = std::vector<Real>;

  static Layout<D> layout(std::array<bool, D> periodic = {}) {
    if constexpr (D == 2) return Layout<D>({13, 21}, periodic);
    if constexpr (D == 3) return Layout<D>({9, 7, 21}, periodic);
  }

  // n particles, at least `margin` from the sides; every tenth on a face or a corner.
  static Particles<Real, D> particles(const Layout<D>& layout, int n, bool affine,
                                      double margin = 0) {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> uniform(0, 1);
    Rows x, v, C;
    std::vector<std::int64_t> id;
    for (int p = 0; p < n; ++p) {
      for (int d = 0; d < D; ++d) {
        const double room = layout.cells[usize(d)] - 2 * margin;
        double at = margin + room * uniform(random);
        if (p % 10 == 0) at = margin + std::round(2 * (room * uniform(random))) / 2;
        x.push_back(static_cast<Real>(at));
        v.push_back(static_cast<Real>(2 * uniform(random) - 1));
      }
      for (int k = 0; k < D * D; ++k) C.push_back(static_cast<Real>(2 * uniform(random) - 1));
      id.push_back(p);
    }
    Particles<Real, D> result(affine);
    result.append(n, x.data(), v.data(), C.data(), id.data());
    return result;
  }

  static std::array<Real, D> place(const Particles<Real, D>& particles, std::int64_t p) {
    std::array<Real, D> x;
    for (int d = 0; d < D; ++d) x[usize(d)] = particles.x(d)[p];
    return x;
  }

  // A linear field of velocities.
  static double linear(int c, const std::array<double, D>& x) {
    double u = 0.3 * (c + 1);
    for (int d = 0; d < D; ++d) u += (0.1 * (c + 1) - 0.07 * (d + 1) * (d + c)) * x[usize(d)];
    return u;
  }
};

template <class Case_>
class GridParticles : public testing::Test {};

using Cases = testing::Types<Case<float, 2>, Case<float, 3>, Case<double, 2>, Case<double, 3>>;
TYPED_TEST_SUITE(GridParticles, Cases);

TYPED_TEST(GridParticles, SortIsStableAndTheTableComplete) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  for (const int n : {0, 1, 17, 5000, 60000}) {
    auto particles = Scene<TypeParam>::particles(layout, n, true);
    for (int round = 0; round < 3; ++round) {
      // The second time they are in order; then one of them is not.
      if (round == 2 && n > 1) particles.x(0)[0] = static_cast<Real>(layout.cells[0]);
      const auto before = particles;
      std::map<std::int64_t, std::int64_t> row_of_id;
      for (std::int64_t p = 0; p < n; ++p) row_of_id[before.id()[p]] = p;
      particles.sort(layout, 2);
      std::int64_t seen = 0;
      ASSERT_EQ(particles.first()[0], 0);
      ASSERT_EQ(particles.first()[layout.size], n);
      for (std::int64_t cell = 0; cell < layout.size; ++cell) {
        std::int64_t last = -1;
        for (std::int32_t p = particles.first()[cell]; p < particles.first()[cell + 1]; ++p) {
          std::array<int, D> i;
          for (int d = 0; d < D; ++d) {
            i[usize(d)] = std::min(static_cast<int>(particles.x(d)[p]), layout.cells[usize(d)] - 1);
          }
          ASSERT_EQ(layout.index(i), cell);
          const std::int64_t from = row_of_id.at(particles.id()[p]);
          ASSERT_GT(from, last);  // stable
          last = from;
          for (int d = 0; d < D; ++d) {
            ASSERT_EQ(particles.x(d)[p], before.x(d)[from]);
            ASSERT_EQ(particles.v(d)[p], before.v(d)[from]);
            for (int c = 0; c < D; ++c) ASSERT_EQ(particles.C(c, d)[p], before.C(c, d)[from]);
          }
          ++seen;
        }
      }
      EXPECT_EQ(seen, n);
    }
  }
}

TYPED_TEST(GridParticles, AppendAndErase) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  auto particles = Scene<TypeParam>::particles(layout, 1000, true);
  const auto before = particles;
  std::vector<std::uint8_t> flags(1000, 0);
  for (std::size_t p = 0; p < 1000; p += 3) flags[p] = 1;
  particles.erase(flags, 2);
  ASSERT_EQ(particles.size(), 666);
  for (std::int64_t p = 0; p < 666; ++p) {
    const std::int64_t from = p / 2 * 3 + 1 + p % 2;
    ASSERT_EQ(particles.id()[p], from);
    ASSERT_EQ(particles.C(D - 1, 0)[p], before.C(D - 1, 0)[from]);
  }
  const std::vector<Real> row(D, Real(0.5));
  for (std::int64_t id = 0; id < 2000; ++id) {
    particles.append(1, row.data(), row.data(), nullptr, &id);
  }
  ASSERT_EQ(particles.size(), 2666);
  EXPECT_EQ(particles.x(0)[0], before.x(0)[1]);
  EXPECT_EQ(particles.C(0, 0)[2665], 0);
  EXPECT_EQ(particles.id()[2665], 1999);
}

TYPED_TEST(GridParticles, ToTheGridAsTheGenericTransfer) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  const Real dx = Real(0.2);
  for (const bool affine : {false, true}) {
    auto particles = Scene<TypeParam>::particles(layout, 3000, affine, 0.5);
    particles.sort(layout, 1);
    Field<Real, D> u(layout), weight(layout);
    transfer_to_grid(particles, layout, dx, u.faces(), weight.faces(), 2);
    std::map<std::pair<int, std::int64_t>, transfer::NodeSum<double>> sums;
    for (std::int64_t p = 0; p < particles.size(); ++p) {
      transfer::AffineMotion<double, D> motion;
      std::array<double, D> x;
      for (int c = 0; c < D; ++c) {
        x[usize(c)] = particles.x(c)[p];
        motion.v[usize(c)] = particles.v(c)[p];
        for (int d = 0; affine && d < D; ++d) motion.C[usize(c)][usize(d)] = particles.C(c, d)[p];
      }
      transfer::particle_to_grid<transfer::Staggered, 1>(
          x, 1.0, motion, double{dx}, [&](int c, const transfer::Index<D>& node) -> auto& {
            std::array<int, D> i;
            for (std::size_t d = 0; d < D; ++d) i[d] = static_cast<int>(node[d]);
            return sums[{c, layout.index(i)}];
          });
    }
    for_faces(layout, [&](int c, std::int64_t i, const auto& x) {
      for (int d = 0; d < D; ++d) {  // not of ghosts
        if (x[usize(d)] < 0 || x[usize(d)] > layout.cells[usize(d)]) return;
      }
      const auto found = sums.find({c, i});
      const auto sum = found == sums.end() ? transfer::NodeSum<double>{} : found->second;
      ASSERT_NEAR(weight.data[usize(c)][usize(i)], sum.mass, 30 * Scene<TypeParam>::kEps);
      if (sum.mass > 0.01) {
        ASSERT_NEAR(u.data[usize(c)][usize(i)], sum.momentum / sum.mass,
                    200 * Scene<TypeParam>::kEps);
      } else if (sum.mass == 0) {
        ASSERT_EQ(u.data[usize(c)][usize(i)], 0);
        ASSERT_EQ(weight.data[usize(c)][usize(i)], 0);
      }
    });
  }
}

TYPED_TEST(GridParticles, FromTheGridAsTheGenericTransferAndLinearFieldsExactly) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  const Real dx = Real(0.2);
  for (const bool random_field : {false, true}) {
    Field<Real, D> u(layout);
    std::mt19937 random(5);
    std::uniform_real_distribution<double> uniform(-1, 1);
    for_faces(layout, [&](int c, std::int64_t i, const auto& x) {
      u.data[usize(c)][usize(i)] =
          static_cast<Real>(random_field ? uniform(random) : Scene<TypeParam>::linear(c, x));
    });
    auto particles = Scene<TypeParam>::particles(layout, 1001, true);
    Move<Real, D> move{.transfer = Transfer::kApic, .u = u.read(), .dx = dx};
    transfer_from_grid(particles, layout, move, 2);
    auto pic = Scene<TypeParam>::particles(layout, 1001, false);
    move.transfer = Transfer::kPic;
    transfer_from_grid(pic, layout, move, 2);
    for (std::int64_t p = 0; p < particles.size(); ++p) {
      const auto at = Scene<TypeParam>::place(particles, p);
      std::array<double, D> x;
      bool corner = false;
      for (std::size_t d = 0; d < D; ++d) {
        x[d] = at[d];
        corner |= std::abs(2 * x[d] - std::round(2 * x[d])) < 1e-4;  // where gradients jump
      }
      const auto want = transfer::grid_to_particle<transfer::Staggered, 1>(
          x, double{dx}, [&](int c, const transfer::Index<D>& node) -> double {
            std::array<int, D> i;
            for (std::size_t d = 0; d < D; ++d) {
              i[d] = std::min(static_cast<int>(node[d]), layout.cells[d]);
            }
            return u.data[usize(c)][usize(layout.index(i))];
          });
      for (int c = 0; c < D; ++c) {
        const double tolerance = 100 * Scene<TypeParam>::kEps;
        ASSERT_NEAR(particles.v(c)[p], want.v[usize(c)], tolerance);
        ASSERT_EQ(pic.v(c)[p], particles.v(c)[p]);
        if (!random_field) {
          ASSERT_NEAR(particles.v(c)[p], Scene<TypeParam>::linear(c, x), tolerance);
        }
        for (int d = 0; d < D && !corner; ++d) {
          ASSERT_NEAR(particles.C(c, d)[p], want.C[usize(c)][usize(d)], 20 * tolerance);
        }
      }
    }
  }
}

TYPED_TEST(GridParticles, ConstantAndLinearVelocitiesPassToTheGridUnchanged) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  const Real dx = Real(0.5);
  auto particles = Scene<TypeParam>::particles(layout, 20000, true, 0.5);
  const std::array<double, D> zero{};
  for (std::int64_t p = 0; p < particles.size(); ++p) {
    std::array<double, D> x;
    for (int d = 0; d < D; ++d) x[usize(d)] = particles.x(d)[p];
    for (int c = 0; c < D; ++c) {
      particles.v(c)[p] = static_cast<Real>(Scene<TypeParam>::linear(c, x));
      for (int d = 0; d < D; ++d) {
        std::array<double, D> unit{};
        unit[usize(d)] = 1;
        particles.C(c, d)[p] = static_cast<Real>(
            (Scene<TypeParam>::linear(c, unit) - Scene<TypeParam>::linear(c, zero)) / double{dx});
      }
    }
  }
  particles.sort(layout, 2);
  Field<Real, D> u(layout), weight(layout);
  transfer_to_grid(particles, layout, dx, u.faces(), weight.faces(), 2);
  for_faces(layout, [&](int c, std::int64_t i, const auto& x) {
    for (int d = 0; d < D; ++d) {
      if (x[usize(d)] < 0 || x[usize(d)] > layout.cells[usize(d)]) return;
    }
    if (weight.data[usize(c)][usize(i)] < 0.01) return;
    ASSERT_NEAR(u.data[usize(c)][usize(i)], Scene<TypeParam>::linear(c, x),
                100 * Scene<TypeParam>::kEps);
  });
}

// sum m v and sum m x x v, with the affine part sum_c e_c x (D_c C_c), D_c the second moments of
// the weights of the component.
template <class Real, int D>
struct Momenta {
  std::array<double, D> linear{};
  std::array<std::array<double, D>, D> angular{};  // x_a v_b - x_b v_a
  void add(const std::array<double, D>& x, int c, double momentum) {
    linear[usize(c)] += momentum;
    for (std::size_t a = 0; a < D; ++a) {
      angular[a][usize(c)] += x[a] * momentum;
      angular[usize(c)][a] -= x[a] * momentum;
    }
  }
};

TYPED_TEST(GridParticles, ApicConservesMomentumAndAngularMomentum) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  auto particles = Scene<TypeParam>::particles(layout, 4000, true, 1);
  particles.sort(layout, 2);
  Field<Real, D> u(layout), weight(layout);
  const auto of_particles = [&] {
    Momenta<Real, D> sum;
    for (std::int64_t p = 0; p < particles.size(); ++p) {
      for (int c = 0; c < D; ++c) {
        std::array<double, D> x, f;
        for (int d = 0; d < D; ++d) {
          x[usize(d)] = particles.x(d)[p];
          const double s = x[usize(d)] - (d == c ? 0 : 0.5);
          f[usize(d)] = s - std::floor(s);
        }
        sum.add(x, c, particles.v(c)[p]);
        for (std::size_t d = 0; d < D; ++d) {
          const double moment = f[d] * (1 - f[d]) * particles.C(c, static_cast<int>(d))[p];
          sum.angular[d][usize(c)] += moment;
          sum.angular[usize(c)][d] -= moment;
        }
      }
    }
    return sum;
  };
  const auto before = of_particles();
  transfer_to_grid(particles, layout, Real(1), u.faces(), weight.faces(), 2);
  Momenta<Real, D> grid;
  for_faces(layout, [&](int c, std::int64_t i, const auto& x) {
    for (int d = 0; d < D; ++d) {
      if (x[usize(d)] < 0 || x[usize(d)] > layout.cells[usize(d)]) return;
    }
    grid.add(x, c, double{weight.data[usize(c)][usize(i)]} * u.data[usize(c)][usize(i)]);
  });
  transfer_from_grid(particles, layout, {.transfer = Transfer::kApic, .u = u.read()}, 2);
  const auto after = of_particles();
  const double tolerance = 4000 * 5 * Scene<TypeParam>::kEps;
  for (std::size_t a = 0; a < D; ++a) {
    EXPECT_NEAR(grid.linear[a], before.linear[a], tolerance);
    EXPECT_NEAR(after.linear[a], before.linear[a], tolerance);
    for (std::size_t b = 0; b < a; ++b) {
      EXPECT_NEAR(grid.angular[a][b], before.angular[a][b], 10 * tolerance);
      EXPECT_NEAR(after.angular[a][b], before.angular[a][b], 10 * tolerance);
    }
  }
}

// Also next to closed sides, which mirror, and through periodic ones.
TYPED_TEST(GridParticles, MomentumIsConservedAtTheSides) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  for (const bool periodic : {false, true}) {
    std::array<bool, D> around;
    around.fill(periodic);
    const auto layout = Scene<TypeParam>::layout(around);
    auto particles = Scene<TypeParam>::particles(layout, 4000, false);
    particles.sort(layout, 2);
    const auto momentum = [&](int c) {
      double sum = 0;
      for (std::int64_t p = 0; p < particles.size(); ++p) sum += particles.v(c)[p];
      return sum;
    };
    std::array<double, D> before;
    for (int c = 0; c < D; ++c) before[usize(c)] = momentum(c);
    Field<Real, D> u(layout), weight(layout);
    transfer_to_grid(particles, layout, Real(1), u.faces(), weight.faces(), 2);
    transfer_from_grid(particles, layout, {.transfer = Transfer::kPic, .u = u.read()}, 2);
    for (int c = 0; c < D; ++c) {
      EXPECT_NEAR(momentum(c), before[usize(c)], 4000 * 2 * Scene<TypeParam>::kEps);
    }
  }
}

TYPED_TEST(GridParticles, FlipKeepsVelocitiesWhenTheGridDoesNotChange) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  auto particles = Scene<TypeParam>::particles(layout, 2000, false);
  particles.sort(layout, 1);
  Field<Real, D> u(layout), weight(layout);
  transfer_to_grid(particles, layout, Real(1), u.faces(), weight.faces(), 1);
  const auto before = particles;
  Move<Real, D> move{
      .transfer = Transfer::kFlip, .flip_ratio = 1, .u = u.read(), .u_old = u.read()};
  transfer_from_grid(particles, layout, move, 2);
  for (int c = 0; c < D; ++c) {
    EXPECT_EQ(std::memcmp(particles.v(c), before.v(c), sizeof(Real) * 2000), 0);
  }
  // A ratio of 0 is PIC.
  move.flip_ratio = 0;
  transfer_from_grid(particles, layout, move, 2);
  auto pic = before;
  move.transfer = Transfer::kPic;
  transfer_from_grid(pic, layout, move, 2);
  for (std::int64_t p = 0; p < 2000; ++p) ASSERT_EQ(particles.v(0)[p], pic.v(0)[p]);
}

// A rotation is linear in x, so the field is exact and only the method's error is left: for y' = i
// omega y, what R(z) = 1 + z + z^2/2 + z^3/6 leaves of exp(z).
TYPED_TEST(GridParticles, PathsInARotationAreOfThirdOrder) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  Layout<D> layout = [] {
    if constexpr (D == 2) return Layout<D>({32, 32});
    if constexpr (D == 3) return Layout<D>({32, 32, 4});
  }();
  Field<Real, D> u(layout);
  for_faces(layout, [&](int c, std::int64_t i, const auto& x) {
    if (c < 2) u.data[usize(c)][usize(i)] = static_cast<Real>(c == 0 ? 16 - x[1] : x[0] - 16);
  });
  double last = 0;
  for (const int steps : {16, 32, 64}) {
    Particles<Real, D> particles(false);
    const std::vector<Real> x{26, 16, 2}, v(3);
    const std::int64_t id = 0;
    particles.append(1, x.data(), v.data(), nullptr, &id);
    const double h = 2 * std::numbers::pi / steps;
    for (int k = 0; k < steps; ++k) {
      advect(particles, layout, {.u = u.read(), .dt = static_cast<Real>(h)}, 1);
    }
    const double error = std::hypot(particles.x(0)[0] - 26, particles.x(1)[0] - 16);
    // The discrete closed form: R(i h)^steps.
    const double re = 1 - h * h / 2, im = h - h * h * h / 6;
    const double r = std::pow(std::hypot(re, im), steps), angle = steps * std::atan2(im, re);
    EXPECT_NEAR(particles.x(0)[0], 16 + 10 * r * std::cos(angle), 2e3 * Scene<TypeParam>::kEps);
    EXPECT_NEAR(particles.x(1)[0], 16 + 10 * r * std::sin(angle), 2e3 * Scene<TypeParam>::kEps);
    if (last > 0) {
      EXPECT_NEAR(std::log2(last / error), 3, 0.15);
    }
    last = error;
  }
}

TYPED_TEST(GridParticles, StayInTheBoxAndOutOfObstaclesAndWrap) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  std::array<bool, D> periodic{};
  periodic[0] = true;
  const auto layout = Scene<TypeParam>::layout(periodic);
  Field<Real, D> u(layout);
  for_faces(layout, [&](int c, std::int64_t i, const auto&) {
    u.data[usize(c)][usize(i)] = static_cast<Real>(c + 1);
  });
  std::vector<Real> solid(usize(layout.size));  // a ball of 2 cells in the middle
  std::array<double, D> middle;
  for (std::size_t d = 0; d < D; ++d) middle[d] = layout.cells[d] / 2.0;
  const auto ball = [&](const auto& x) {
    double square = 0;
    for (std::size_t d = 0; d < D; ++d) square += (x[d] - middle[d]) * (x[d] - middle[d]);
    return std::sqrt(square) - 2;
  };
  for_faces(layout, [&](int c, std::int64_t i, auto x) {
    for (int d = 0; d < D; ++d) x[usize(d)] = std::floor(x[usize(d)]);
    if (c == 0) solid[usize(i)] = static_cast<Real>(ball(x));
  });
  auto particles = Scene<TypeParam>::particles(layout, 3000, false);
  const auto before = particles;
  Move<Real, D> move{.u = u.read(), .dt = Real(0.7)};
  EXPECT_EQ(advect(particles, layout, move, 2), -1);
  for (std::int64_t p = 0; p < 3000; ++p) {
    const double n = layout.cells[0], to = before.x(0)[p] + 0.7;
    EXPECT_NEAR(std::remainder(particles.x(0)[p] - to, n), 0, 30 * Scene<TypeParam>::kEps);
    EXPECT_GE(particles.x(0)[p], 0);
    EXPECT_LE(particles.x(0)[p], n);
    const Real high = static_cast<Real>(layout.cells[1]) - move.walls.margin;
    EXPECT_EQ(particles.x(1)[p],
              std::min(high, static_cast<Real>(std::fma(Real(0.7), Real(2), before.x(1)[p]))) +
                  0 * particles.x(1)[p])
        << p;
    if (testing::Test::HasFailure()) return;
  }
  move.walls.solid = solid.data();
  move.dt = 0;
  const auto start = particles;
  advect(particles, layout, move, 2);
  for (std::int64_t p = 0; p < 3000; ++p) {
    std::array<double, D> from, x;
    for (int d = 0; d < D; ++d) from[usize(d)] = start.x(d)[p], x[usize(d)] = particles.x(d)[p];
    if (ball(from) > 0.1) {
      for (int d = 0; d < D; ++d) ASSERT_EQ(particles.x(d)[p], start.x(d)[p]);
    } else if (ball(from) > -1) {  // not near the centre, where the distance has no gradient
      ASSERT_GT(ball(x), -0.2);
    }
  }
  // A displacement of faces; and what is not finite is found, and stays in the box.
  const auto at = particles;
  displace(particles, layout, u.read(), {}, 2);
  EXPECT_NEAR(std::remainder(particles.x(0)[7] - at.x(0)[7] - 1, layout.cells[0]), 0,
              30 * Scene<TypeParam>::kEps);
  particles.x(1)[1234] = std::numeric_limits<Real>::quiet_NaN();
  EXPECT_EQ(advect(particles, layout, move, 2), 1234);
  EXPECT_GE(particles.x(1)[1234], 0);
}

TYPED_TEST(GridParticles, SameBitsForAnyNumberOfThreads) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  std::array<bool, D> periodic{};
  periodic[D - 1] = true;
  const auto layout = Scene<TypeParam>::layout(periodic);
  for (const Transfer transfer : {Transfer::kFlip, Transfer::kApic}) {
    std::vector<Particles<Real, D>> results;
    std::vector<std::vector<Real>> fields;
    for (const int threads : {1, 2, 3}) {
      auto particles = Scene<TypeParam>::particles(layout, 70000, transfer == Transfer::kApic);
      Field<Real, D> u(layout), weight(layout);
      Extrapolation<Real, D> extrapolate;
      std::vector<Real> density(usize(layout.size)), phi(density);
      AlignedBuffer<Real> scratch;
      for (int step = 0; step < 3; ++step) {
        particles.sort(layout, threads);
        transfer_to_grid(particles, layout, Real(0.1), u.faces(), weight.faces(), threads);
        const auto old = u;
        extrapolate(layout, weight.read(), u.faces(), 3, threads);
        number_density(particles, layout, Real(8), density.data(), threads);
        level_set<Real, D>(particles, layout, density.data(), {}, phi.data(), scratch, threads);
        const Move<Real, D> move{.transfer = transfer,
                                 .u = u.read(),
                                 .u_old = old.read(),
                                 .dx = Real(0.1),
                                 .dt = Real(0.05)};
        EXPECT_EQ(transfer_and_advect(particles, layout, move, threads), -1);
      }
      results.push_back(particles);
      fields.push_back(phi);
    }
    for (std::size_t k = 1; k < 3; ++k) {
      for (int d = 0; d < D; ++d) {
        const auto bytes = usize(results[0].size()) * sizeof(Real);
        EXPECT_EQ(std::memcmp(results[k].x(d), results[0].x(d), bytes), 0);
        EXPECT_EQ(std::memcmp(results[k].v(d), results[0].v(d), bytes), 0);
      }
      EXPECT_EQ(std::memcmp(results[k].id(), results[0].id(), usize(results[0].size()) * 8), 0);
      for (std::size_t i = usize(layout.first); i < fields[0].size(); ++i) {
        ASSERT_EQ(fields[k][i], fields[0][i]);
      }
    }
  }
}

TYPED_TEST(GridParticles, NoneOrAllInOneCell) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  Field<Real, D> u(layout), weight(layout);
  Extrapolation<Real, D> extrapolate;
  std::vector<Real> density(usize(layout.size)), phi(density);
  AlignedBuffer<Real> scratch;
  for (const int n : {0, 100000}) {
    Particles<Real, D> particles(true);
    std::vector<Real> x(usize(n * D), Real(2.75)), v(usize(n * D), Real(1));
    std::vector<std::int64_t> id(usize(n), 0);
    particles.append(n, x.data(), v.data(), nullptr, id.data());
    particles.sort(layout, 2);
    transfer_to_grid(particles, layout, Real(1), u.faces(), weight.faces(), 2);
    extrapolate(layout, weight.read(), u.faces(), 2, 2);
    number_density(particles, layout, Real(8), density.data(), 2);
    level_set<Real, D>(particles, layout, density.data(), {}, phi.data(), scratch, 2);
    double sum = 0;
    for (const Real w : weight.data[0]) sum += w;
    EXPECT_NEAR(sum, n, 1e-5 * n);
    EXPECT_EQ(transfer_and_advect(particles, layout, {.u = u.read(), .dt = Real(0.5)}, 2), -1);
    if (n > 0) {
      EXPECT_NEAR(particles.x(0)[n - 1], 3.25, 1e-5);
    }
  }
}

TYPED_TEST(GridParticles, ExtrapolationIsLayerByLayer) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  std::array<bool, D> periodic{};
  periodic[0] = true;
  const auto layout = Scene<TypeParam>::layout(periodic);
  Field<Real, D> u(layout), weight(layout);
  for_faces(layout, [&](int c, std::int64_t i, const auto& x) {
    if (x[0] >= 1 || x[0] < 0) return;  // the first plane of cells is known
    weight.data[usize(c)][usize(i)] = 1;
    u.data[usize(c)][usize(i)] = static_cast<Real>(c + 1);
  });
  Extrapolation<Real, D> extrapolate;
  extrapolate(layout, weight.read(), u.faces(), 3, 2);
  for_faces(layout, [&](int c, std::int64_t i, const auto& x) {
    for (std::size_t d = 0; d < D; ++d) {
      if (x[d] < 0 || x[d] >= layout.cells[d]) return;
    }
    const double place = std::floor(x[0]);
    const bool near = place <= 3 || place >= layout.cells[0] - 3;
    ASSERT_NEAR(u.data[usize(c)][usize(i)], near ? c + 1 : 0, 1e-6) << c << " " << x[0];
  });
}

// A lattice of 2^D particles a cell, of those that are inside.
template <class Real, int D>
Particles<Real, D> lattice(const Layout<D>& layout, const auto& inside) {
  std::vector<Real> x;
  std::array<int, D> n;
  std::int64_t count = 1;
  for (std::size_t d = 0; d < D; ++d) count *= n[d] = 2 * layout.cells[d];
  std::vector<std::int64_t> id;
  for (std::int64_t k = 0; k < count; ++k) {
    std::int64_t rest = k;
    std::array<double, D> at;
    for (std::size_t d = 0; d < D; ++d, rest /= n[d - 1]) {
      at[d] = static_cast<double>(rest % n[d]) / 2 + 0.25;
    }
    if (!inside(at)) continue;
    for (const double a : at) x.push_back(static_cast<Real>(a));
    id.push_back(k);
  }
  Particles<Real, D> particles(false);
  particles.append(std::int64_t(id.size()), x.data(), x.data(), nullptr, id.data());
  particles.sort(layout, 2);
  return particles;
}

TYPED_TEST(GridParticles, DensityOfALatticeIsOneAndAPoolIsLevel) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  const auto layout = Scene<TypeParam>::layout();
  std::vector<Real> density(usize(layout.size)), phi(density);
  AlignedBuffer<Real> scratch;
  for (const double height : {6.0, 6.5, 7.0}) {
    const auto particles =
        lattice<Real, D>(layout, [&](const auto& x) { return x[D - 1] < height; });
    number_density(particles, layout, Real(1 << D), density.data(), 2);
    level_set<Real, D>(particles, layout, density.data(), {}, phi.data(), scratch, 2);
    for (std::int64_t r = 0; r < layout.rows(); ++r) {
      const Real* const rho = density.data() + layout.row(r);
      const Real* const distance = phi.data() + layout.row(r);
      for (int k = 0; k < 5; ++k) ASSERT_NEAR(rho[k], 1, 1e-5);
      for (int k = 8; k < layout.row_length(); ++k) ASSERT_EQ(rho[k], 0);
      double zero = -1;
      for (int k = 0; k + 1 < layout.row_length(); ++k) {
        if (distance[k] < 0 && distance[k + 1] >= 0) {
          zero = k + 0.5 + distance[k] / (distance[k] - distance[k + 1]);
        }
      }
      ASSERT_NEAR(zero, height, 0.05);
      for (int k = static_cast<int>(height) - 3; k <= static_cast<int>(height) + 2; ++k) {
        ASSERT_NEAR(distance[k], k + 0.5 - height, 0.1);
      }
      EXPECT_EQ(distance[0], -4);
      EXPECT_EQ(distance[layout.row_length() - 1], 4);
    }
  }
}

TYPED_TEST(GridParticles, LevelSetOfADrop) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  Layout<D> layout = [] {
    if constexpr (D == 2) return Layout<D>({24, 24});
    if constexpr (D == 3) return Layout<D>({24, 24, 24});
  }();
  const auto distance = [](const auto& x) {
    double square = 0;
    for (const double a : x) square += (a - 11.8) * (a - 11.8);
    return std::sqrt(square) - 7;
  };
  const auto particles = lattice<Real, D>(layout, [&](const auto& x) { return distance(x) < 0; });
  std::vector<Real> density(usize(layout.size)), phi(density);
  AlignedBuffer<Real> scratch;
  number_density(particles, layout, Real(1 << D), density.data(), 2);
  level_set<Real, D>(particles, layout, density.data(), {}, phi.data(), scratch, 2);
  double mean = 0;
  int count = 0;
  for_faces(layout, [&](int c, std::int64_t i, auto x) {
    x[usize(c)] += 0.5;  // the centre of the cell
    const double want = distance(x);
    if (c > 0 || std::abs(want) > 2) return;
    const double error = phi[usize(i)] - want;
    ASSERT_LT(std::abs(error), 0.35);
    mean += std::abs(error);
    ++count;
  });
  EXPECT_LT(mean / count, 0.12);
}

}  // namespace
}  // namespace substep::gridfluid
