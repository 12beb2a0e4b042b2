#include "substep/pbf/liquid.h"

#include <algorithm>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/rows_by_id.h"
#include "substep/core/usize.h"
#include "substep/geometry/kept_colliders.h"
#include "substep/pbf/fluid.h"

namespace substep::pbf {
namespace {

using geometry::Collider;
using Colliders = std::vector<std::shared_ptr<Collider>>;

std::vector<Collider> copies(const Colliders& colliders) {
  std::vector<Collider> out;
  for (const auto& collider : colliders) out.push_back(*collider);
  return out;
}

template <class Real>
Point<Real> point(const Vec3& v, Real w) {
  return {static_cast<Real>(v.x()), static_cast<Real>(v.y()), static_cast<Real>(v.z()), w};
}

template <class Real>
Numbers numbers(const std::vector<Point<Real>>& points) {
  const Real* from = reinterpret_cast<const Real*>(points.data());
  return std::vector<Real>(from, from + 4 * points.size());
}
template <class Real>
std::vector<Point<Real>> points(const Numbers& numbers) {
  const auto* given = std::get_if<std::vector<Real>>(&numbers);
  if (given == nullptr) throw InputError("state: expected numbers of the fluid's own precision");
  std::vector<Point<Real>> out(given->size() / 4);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const Real* row = given->data() + 4 * i;
    out[i] = {row[0], row[1], row[2], row[3]};
  }
  return out;
}

template <class Real>
class LiquidOf final : public Liquid {
 public:
  LiquidOf(const Vec3& origin, Colliders colliders, const FluidOptions& options,
           geometry::ParticleFlow flow)
      : fluid_(origin, copies(colliders), options, std::move(flow)),
        colliders_(std::move(colliders)) {}

  std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v,
                   std::span<const std::int32_t> fluid) override {
    return fluid_.add(x, v, fluid);
  }
  void remove(Places places) override {
    const std::vector<std::size_t> rows = rows_of_ids();
    std::vector<std::uint8_t> flags(rows.size());
    for (const std::int64_t place : places) flags[rows[usize(place)]] = 1;
    fluid_.remove(flags);
  }
  void step(double dt) override {
    read_colliders();
    fluid_.step(dt);
    for (std::size_t c = 0; c < colliders_.size(); ++c)
      *colliders_[c] = fluid_.boundary.colliders()[c];
  }
  void keep() override {
    kept_ = state();
    kept_colliders_.keep(colliders_);
  }
  void rewind() override {
    restore(kept_);
    kept_colliders_.rewind(colliders_);
  }

  std::int64_t size() const override { return fluid_.particles.size(); }
  int dimension() const override { return fluid_.options.density.dimension; }
  std::vector<std::int64_t> ids() const override {
    return column<std::int64_t>([&](std::size_t i) { return fluid_.particles.id[i]; });
  }
  std::vector<std::int32_t> fluids() const override {
    return column<std::int32_t>([&](std::size_t i) { return fluid_.particles.fluid[i]; });
  }
  std::vector<double> positions() const override {
    return vectors([&](std::size_t i) { return fluid_.world(fluid_.particles.x[i]); });
  }
  std::vector<double> velocities() const override {
    return vectors([&](std::size_t i) { return xyz(fluid_.particles.v[i]); });
  }
  std::vector<double> densities() override {
    read_colliders();
    const std::vector<Real> values = fluid_.densities();
    return column<double>([&](std::size_t i) { return static_cast<double>(values[i]); });
  }
  void set_positions(std::span<const Vec3> x, Places places) override {
    fluid_.check_reach(x);
    write(places, [&](std::size_t i, std::size_t k) {
      fluid_.particles.x[i] = fluid_.local(x[k], fluid_.particles.x[i].w);
    });
  }
  void set_velocities(std::span<const Vec3> v, Places places) override {
    write(places, [&](std::size_t i, std::size_t k) {
      fluid_.particles.v[i] = point<Real>(v[k], fluid_.particles.v[i].w);
    });
  }
  void set_forces(std::span<const Vec3> f, Places places) override {
    std::vector<Point<Real>> forces = fluid_.particles.f;
    forces.resize(fluid_.particles.x.size());
    write(places, [&](std::size_t i, std::size_t k) { forces[i] = point<Real>(f[k], Real{0}); });
    fluid_.particles.f.swap(forces);
  }

  double time() const override { return fluid_.time; }
  void set_time(double time) override { fluid_.time = time; }
  int threads() const override { return fluid_.options.threads; }
  void set_threads(int threads) override { fluid_.options.threads = threads; }
  FluidReport report() const override { return fluid_.report; }
  Energies energies() const override { return fluid_.energies(); }
  double fastest() const override { return fluid_.fastest(); }
  double lone_density() const override { return fluid_.density.volume() * fluid_.density.value(0); }
  const geometry::ParticleFlow::Counts& counts() const override { return fluid_.flow.counts; }

  LiquidState state() const override {
    const Particles<Real>& p = fluid_.particles;
    return {.time = fluid_.time,
            .last_dt = fluid_.last_dt,
            .next_id = fluid_.next_id,
            .positions = numbers(p.x),
            .velocities = numbers(p.v),
            .forces = numbers(p.f),
            .ids = p.id,
            .fluids = p.fluid,
            .flow = fluid_.flow.counts};
  }
  void restore(const LiquidState& state) override {
    fluid_.flow.check(state.flow);
    geometry::ParticleFlow::Counts counts = state.flow;
    fluid_.particles = {.x = points<Real>(state.positions),
                        .v = points<Real>(state.velocities),
                        .f = points<Real>(state.forces),
                        .id = state.ids,
                        .fluid = state.fluids};
    fluid_.flow.counts = std::move(counts);
    fluid_.time = state.time;
    fluid_.last_dt = state.last_dt;
    fluid_.next_id = state.next_id;
    fluid_.report = {};
  }

 private:
  void read_colliders() {
    for (std::size_t c = 0; c < colliders_.size(); ++c)
      fluid_.boundary.colliders()[c] = *colliders_[c];
  }

  std::vector<std::size_t> rows_of_ids() const {
    return rows_by_id(fluid_.particles.id, fluid_.next_id);
  }
  template <class T, class Value>
  std::vector<T> column(const Value& value) const {
    std::vector<T> out;
    out.reserve(fluid_.particles.id.size());
    for (const std::size_t row : rows_of_ids()) out.push_back(value(row));
    return out;
  }
  template <class Value>
  std::vector<double> vectors(const Value& value) const {
    std::vector<double> out(fluid_.particles.id.size() * usize(dimension()));
    double* to = out.data();
    for (const std::size_t row : rows_of_ids()) {
      const Vec3 v = value(row);
      to = std::copy_n(v.data(), dimension(), to);
    }
    return out;
  }
  // put(row, k) of the k-th of the places.
  template <class Put>
  void write(Places places, const Put& put) {
    const std::vector<std::size_t> rows = rows_of_ids();
    for (std::size_t k = 0; k < places.size(); ++k) put(rows[usize(places[k])], k);
  }

  Fluid<Real> fluid_;
  Colliders colliders_;
  LiquidState kept_;
  geometry::KeptColliders kept_colliders_;
};

}  // namespace

std::unique_ptr<Liquid> make_liquid(Precision precision, const Vec3& origin,
                                    std::vector<std::shared_ptr<geometry::Collider>> colliders,
                                    const FluidOptions& options, geometry::ParticleFlow flow) {
  if (precision == Precision::kSingle)
    return std::make_unique<LiquidOf<float>>(origin, std::move(colliders), options,
                                             std::move(flow));
  return std::make_unique<LiquidOf<double>>(origin, std::move(colliders), options, std::move(flow));
}

}  // namespace substep::pbf
