// Advection along the paths of a flow, against closed forms.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "substep/gridfluid/flow/semi_lagrangian.h"
#include "substep/gridfluid/grid/ghosts.h"

namespace substep::gridfluid {
namespace {

template <class Real_, int D_>
struct Case {
  using Real = Real_;
  static constexpr int D = D_;
};

// Sizes that are no whole vectors.
template <int D>
Layout<D> layout_of(bool periodic) {
  std::array<int, D> cells{21, 13};
  if constexpr (D == 3) cells[2] = 19;
  std::array<bool, D> wraps;
  wraps.fill(periodic);
  return Layout<D>(cells, wraps);
}

template <class Real, int D>
struct Scene {
  using Point = std::array<double, D>;

  explicit Scene(const Layout<D>& layout_) : layout(layout_) {
    for (auto& u : data) u.assign(usize(layout.size), Real(0));
    from = to = data[0];
  }
  Velocity<Real, D> u() {
    Velocity<Real, D> spans;
    for (std::size_t a = 0; a < D; ++a) spans[a] = data[a];
    return spans;
  }
  // Of cells, or of the faces of an axis, ghosts included: x[i] = f(where it is, in cells).
  template <class F>
  void set(std::vector<Real>& x, int faces_of, const F& f) const {
    std::array<int, D> begin, end;
    for (std::size_t a = 0; a < D; ++a) begin[a] = -1, end[a] = layout.cells[a] + 1;
    std::array<int, D> cell = begin;
    do {
      const std::int64_t i = layout.index(cell);
      if (i < layout.size) x[usize(i)] = Real(f(middle(cell, faces_of)));
    } while (next_in_block(cell, begin, end));
  }
  static Point middle(const std::array<int, D>& cell, int faces_of) {
    Point x;
    for (int a = 0; a < D; ++a) x[usize(a)] = cell[usize(a)] + (a == faces_of ? 0 : 0.5);
    return x;
  }
  void advect(double reach, int faces_of, bool maccormack, int threads = 1) {
    paths.follow(u(), reach, maccormack, threads);
    const auto refill = [&](std::span<Real> x) {
      for (std::size_t i = 0; i < x.size(); ++i) {
        if (outside(static_cast<std::int64_t>(i), faces_of)) x[i] = from[i];
      }
      if (layout.periodic[0]) fill_ghosts(layout, kCentres, x.data());
    };
    paths.advect(faces_of, block(faces_of), std::span<const Real>(from), std::span<Real>(to),
                 refill, threads);
  }
  Block<D> block(int faces_of) const {
    return faces_of < 0 ? all_cells(layout) : all_faces(layout, usize(faces_of));
  }
  bool outside(std::int64_t i, int faces_of) const {
    const std::array<int, D> cell = layout.cell(i);
    const Block<D> all = block(faces_of);
    for (std::size_t a = 0; a < D; ++a) {
      if (cell[a] < 0 || cell[a] >= all.to[a]) return true;
    }
    return i < layout.first;
  }
  // use(cell, i) at least `margin` cells from the sides.
  template <class Use>
  void for_inner(int faces_of, int margin, const Use& use) const {
    Block<D> inner = block(faces_of);
    for (std::size_t a = 0; a < D; ++a) inner.from[a] += margin, inner.to[a] -= margin;
    std::array<int, D> cell = inner.from;
    do {
      use(cell, usize(layout.index(cell)));
    } while (next_in_block(cell, inner.from, inner.to));
  }
  void set_random(std::mt19937& random, double speed) {
    std::uniform_real_distribution<double> any(0, 1);
    for (auto& x : data) {
      for (Real& v : x) v = Real(speed * (2 * any(random) - 1));
    }
    for (Real& v : from) v = Real(any(random));
  }

  Layout<D> layout;
  std::array<std::vector<Real>, D> data;
  std::vector<Real> from, to;
  SemiLagrangian<Real, D> paths{layout};
};

template <class T>
class FlowPaths : public testing::Test {};
using Cases = testing::Types<Case<float, 2>, Case<float, 3>, Case<double, 2>, Case<double, 3>>;
TYPED_TEST_SUITE(FlowPaths, Cases);

// In a rotation about the middle by the angle h, Ralston's method is the Taylor series to h^3, and
// linear fields are interpolated exactly: the coordinate that is carried is that of the path's end.
TYPED_TEST(FlowPaths, OfARotationAreItsTaylorSeries) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  Scene<Real, D> scene(layout_of<D>(false));
  const double cx = 10.5, cy = 6.5, h = 0.2;
  scene.set(scene.data[0], 0, [&](const auto& x) { return -(x[1] - cy); });
  scene.set(scene.data[1], 1, [&](const auto& x) { return x[0] - cx; });
  const double c = 1 - h * h / 2, s = h - h * h * h / 6;
  for (int faces_of = -1; faces_of < D; ++faces_of) {
    scene.set(scene.from, faces_of, [](const auto& x) { return x[0]; });
    for (const bool maccormack : {false, true}) {
      scene.advect(h, faces_of, maccormack);
      scene.for_inner(faces_of, 3, [&](const auto& cell, std::size_t i) {
        const auto x = scene.middle(cell, faces_of);
        const double back = cx + c * (x[0] - cx) + s * (x[1] - cy);
        // There and back is c^2 + s^2 of it: 1 but for h^4.
        const double more = maccormack ? (1 - c * c - s * s) * (x[0] - cx) / 2 : 0;
        ASSERT_NEAR(scene.to[i], back + more, sizeof(Real) == 4 ? 1e-5 : 1e-13);
      });
    }
  }
}

// Through periodic sides too, and further than the box.
TYPED_TEST(FlowPaths, OfWholeCellsCarryEachNumberToItsPlace) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  Scene<Real, D> scene(layout_of<D>(true));
  std::mt19937 random(1);
  scene.set_random(random, 0);
  fill_ghosts(scene.layout, kCentres, scene.from.data());
  std::array<int, D> by{3, -15};
  if constexpr (D == 3) by[2] = 40;
  for (std::size_t a = 0; a < D; ++a) std::fill(scene.data[a].begin(), scene.data[a].end(), by[a]);
  for (const bool maccormack : {false, true}) {
    scene.advect(1, -1, maccormack);
    scene.for_inner(-1, 0, [&](std::array<int, D> cell, std::size_t i) {
      for (std::size_t a = 0; a < D; ++a) {
        const int n = scene.layout.cells[a];
        cell[a] = ((cell[a] - by[a]) % n + n) % n;
      }
      ASSERT_NEAR(scene.to[i], scene.from[usize(scene.layout.index(cell))],
                  sizeof(Real) == 4 ? 2e-5 : 1e-13);
    });
  }
}

TYPED_TEST(FlowPaths, MakeNoNewExtremesAndDoNotDependOnThreads) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  for (const bool periodic : {false, true}) {
    Scene<Real, D> scene(layout_of<D>(periodic));
    std::mt19937 random(2);
    scene.set_random(random, 3);
    for (int faces_of = -1; faces_of < D; ++faces_of) {
      scene.advect(1, faces_of, true);
      scene.for_inner(faces_of, 0, [&](const auto&, std::size_t i) {
        ASSERT_GE(scene.to[i], Real(-1e-6));
        ASSERT_LE(scene.to[i], Real(1 + 1e-6));
      });
      const std::vector<Real> one = scene.to;
      scene.advect(1, faces_of, true, 3);
      EXPECT_EQ(scene.to, one);
    }
  }
}

// Of a step that is no number.
TYPED_TEST(FlowPaths, StayInTheBox) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  for (const bool periodic : {false, true}) {
    Scene<Real, D> scene(layout_of<D>(periodic));
    std::mt19937 random(3);
    scene.set_random(random, 1);
    for (const double reach : {1e6, 1e300}) {
      scene.advect(reach, -1, true);
      scene.for_inner(-1, 0, [&](const auto&, std::size_t i) {
        ASSERT_TRUE(scene.to[i] >= Real(-1e-6) && scene.to[i] <= Real(1 + 1e-6));
      });
    }
  }
}

}  // namespace
}  // namespace substep::gridfluid
