#include "substep/gridfluid/flow/any_grid_flow.h"

#include <algorithm>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/flow/flow.h"

namespace substep::gridfluid {
namespace {

using SharedColliders = std::vector<std::shared_ptr<geometry::Collider>>;

std::vector<geometry::Collider> values_of(const SharedColliders& colliders) {
  std::vector<geometry::Collider> out;
  for (const auto& collider : colliders) out.push_back(*collider);
  return out;
}

// The numbers of cells, or of the faces of an axis, from an array with ghosts, and into one.
template <class To, int D, class From>
std::vector<To> packed(const Layout<D>& layout, std::span<const From> x, int faces_of) {
  std::vector<To> out;
  const int length = layout.row_length(faces_of);
  out.reserve(usize(layout.rows(faces_of) * length));
  for (std::int64_t r = 0; r < layout.rows(faces_of); ++r) {
    const std::int64_t begin = layout.row(r, faces_of);
    for (std::int64_t i = begin; i < begin + length; ++i) {
      out.push_back(static_cast<To>(x[usize(i)]));
    }
  }
  return out;
}
template <class To, int D, class From>
void unpack(const Layout<D>& layout, std::span<const From> from, int faces_of, std::span<To> to) {
  std::size_t n = 0;
  for (std::int64_t r = 0; r < layout.rows(faces_of); ++r) {
    const std::int64_t begin = layout.row(r, faces_of);
    for (std::int64_t i = begin; i < begin + layout.row_length(faces_of); ++i) {
      to[usize(i)] = static_cast<To>(from[n++]);
    }
  }
}

template <class Real, int D>
class FlowOf final : public AnyGridFlow {
 public:
  FlowOf(const FlowBox& box, SharedColliders colliders, std::vector<FlowSource> sources,
         const FlowOptions& options)
      : flow_(layout_of(box), box.low, box.dx, sides_of(box), values_of(colliders),
              std::move(sources), options),
        colliders_(std::move(colliders)) {}

  void step(double dt) override {
    read_colliders();
    flow_.step(dt);
    for (std::size_t c = 0; c < colliders_.size(); ++c) *colliders_[c] = flow_.colliders[c];
  }
  FlowSums sums() override {
    read_colliders();
    return flow_.sums();
  }
  FlowLimits limits() const override { return flow_.limits(); }
  std::vector<double> sample(std::span<const Vec3> points) override {
    read_colliders();
    return flow_.sample(points);
  }

  int dimension() const override { return D; }
  std::vector<double> velocities() const override { return flow_.centred(); }
  std::vector<double> velocity(int axis) const override {
    return packed<double>(layout(), flow_.velocity(usize(axis)), axis);
  }
  std::vector<double> scalar(int k) const override {
    return packed<double>(layout(), flow_.scalar(usize(k)), -1);
  }
  std::vector<double> pressure() const override {
    std::vector<double> p = packed<double>(layout(), flow_.pressure(), -1);
    for (double& x : p) x *= flow_.options.density;
    return p;
  }
  std::vector<std::uint8_t> fluid() override {
    read_colliders();
    const std::vector<Cell> cells = flow_.cells();
    std::vector<std::uint8_t> out;
    for (std::int64_t r = 0; r < layout().rows(); ++r) {
      const std::int64_t begin = layout().row(r);
      for (std::int64_t i = begin; i < begin + layout().row_length(); ++i) {
        out.push_back(cells[usize(i)] == Cell::kFluid);
      }
    }
    return out;
  }
  void set_velocity(const std::vector<std::vector<double>>& faces) override {
    read_colliders();
    std::array<std::vector<Real>, D> before;
    for (std::size_t a = 0; a < D; ++a) {
      const auto u = flow_.velocity(a);
      before[a].assign(u.begin(), u.end());
    }
    try {
      for (int a = 0; a < D; ++a) {
        unpack(layout(), std::span<const double>(faces[usize(a)]), a, flow_.velocity(usize(a)));
      }
      flow_.project();
    } catch (...) {
      for (std::size_t a = 0; a < D; ++a) {
        std::copy(before[a].begin(), before[a].end(), flow_.velocity(a).begin());
      }
      throw;
    }
  }
  void project() override {
    read_colliders();
    flow_.project();
  }
  void set_scalar(int k, std::span<const double> values) override {
    const std::span<Real> x = flow_.scalar(usize(k));
    if (k != flow_.options.smoke) return unpack(layout(), values, -1, x);
    read_colliders();
    const std::vector<Real> before(x.begin(), x.end());
    try {
      unpack(layout(), values, -1, x);
      flow_.settle();
    } catch (...) {
      std::copy(before.begin(), before.end(), x.begin());
      throw;
    }
  }

  double time() const override { return flow_.time; }
  void set_time(double time) override { flow_.time = time; }
  int threads() const override { return flow_.options.threads; }
  void set_threads(int threads) override { flow_.options.threads = threads; }
  FlowReport report() const override { return flow_.report; }

  FlowState state() const override {
    FlowState state{.time = flow_.time,
                    .velocity = {},
                    .scalars = {},
                    .pressure = packed<double>(layout(), flow_.pressure(), -1)};
    for (int a = 0; a < D; ++a) {
      state.velocity.emplace_back(packed<Real>(layout(), flow_.velocity(usize(a)), a));
    }
    for (std::size_t k = 0; k < flow_.options.scalars.size(); ++k) {
      state.scalars.emplace_back(packed<Real>(layout(), flow_.scalar(k), -1));
    }
    return state;
  }
  void restore(const FlowState& state) override {
    for (const auto* arrays : {&state.velocity, &state.scalars}) {
      for (const Numbers& x : *arrays) {
        if (!std::holds_alternative<std::vector<Real>>(x)) {
          throw InputError("state: expected numbers of the flow's own precision");
        }
      }
    }
    const auto put = [&](const Numbers& x, int faces_of, std::span<Real> to) {
      unpack(layout(), std::span<const Real>(std::get<std::vector<Real>>(x)), faces_of, to);
    };
    for (int a = 0; a < D; ++a) put(state.velocity[usize(a)], a, flow_.velocity(usize(a)));
    for (std::size_t k = 0; k < state.scalars.size(); ++k) {
      put(state.scalars[k], -1, flow_.scalar(k));
    }
    unpack(layout(), std::span<const double>(state.pressure), -1, flow_.pressure());
    flow_.hold_sides();
    flow_.time = state.time;
    flow_.report = {};
  }

 private:
  const Layout<D>& layout() const { return flow_.layout(); }
  static Layout<D> layout_of(const FlowBox& box) {
    std::array<int, D> cells;
    std::array<bool, D> periodic;
    for (std::size_t a = 0; a < D; ++a) {
      cells[a] = box.cells[a];
      periodic[a] = box.sides[a][0].kind == SideKind::kPeriodic;
    }
    return Layout<D>(cells, periodic);
  }
  static Sides<D> sides_of(const FlowBox& box) {
    Sides<D> sides;
    for (std::size_t a = 0; a < D; ++a) sides[a] = box.sides[a];
    return sides;
  }
  void read_colliders() {
    for (std::size_t c = 0; c < colliders_.size(); ++c) flow_.colliders[c] = *colliders_[c];
  }

  Flow<Real, D> flow_;
  SharedColliders colliders_;
};

template <class Real>
std::unique_ptr<AnyGridFlow> made(const FlowBox& box, SharedColliders colliders,
                                  std::vector<FlowSource> sources, const FlowOptions& options) {
  if (box.dimension == 2) {
    return std::make_unique<FlowOf<Real, 2>>(box, std::move(colliders), std::move(sources),
                                             options);
  }
  return std::make_unique<FlowOf<Real, 3>>(box, std::move(colliders), std::move(sources), options);
}

}  // namespace

std::unique_ptr<AnyGridFlow> make_flow(Precision precision, const FlowBox& box,
                                       SharedColliders colliders, std::vector<FlowSource> sources,
                                       const FlowOptions& options) {
  return precision == Precision::kSingle
             ? made<float>(box, std::move(colliders), std::move(sources), options)
             : made<double>(box, std::move(colliders), std::move(sources), options);
}

}  // namespace substep::gridfluid
