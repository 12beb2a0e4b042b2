#include "substep/gridfluid/liquid/liquid.h"

#include <algorithm>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/rows_by_id.h"
#include "substep/core/usize.h"
#include "substep/geometry/kept_colliders.h"
#include "substep/gridfluid/liquid/grid_liquid.h"

namespace substep::gridfluid {
namespace {

using geometry::Collider;
using Colliders = std::vector<std::shared_ptr<Collider>>;

std::vector<Collider> copies(const Colliders& colliders) {
  std::vector<Collider> out;
  for (const auto& collider : colliders) out.push_back(*collider);
  return out;
}

template <class Real, int D>
class LiquidOf final : public Liquid {
 public:
  LiquidOf(Colliders colliders, const LiquidOptions& options, geometry::ParticleFlow flow)
      : liquid_(copies(colliders), options, std::move(flow)), colliders_(std::move(colliders)) {}

  std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v) override {
    return liquid_.add(x, v);
  }
  void remove(Places places) override {
    const std::vector<std::size_t> rows = rows_of_ids();
    std::vector<std::uint8_t> flags(rows.size());
    for (const std::int64_t place : places) flags[rows[usize(place)]] = 1;
    liquid_.remove(flags);
  }
  void step(double dt) override {
    read_colliders();
    liquid_.step(dt);
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      *colliders_[c] = liquid_.obstacles.colliders[c];
    }
  }

  void keep() override {
    liquid_.keep();
    kept_colliders_.keep(colliders_);
  }
  void rewind() override {
    liquid_.rewind();
    kept_colliders_.rewind(colliders_);
  }

  std::int64_t size() const override { return liquid_.particles.size(); }
  std::int64_t deep_cells() const override { return liquid_.band ? liquid_.band->count() : 0; }
  int dimension() const override { return D; }
  std::vector<std::int64_t> ids() const override {
    std::vector<std::int64_t> out;
    for (const std::size_t row : rows_of_ids()) out.push_back(liquid_.particles.id()[row]);
    return out;
  }
  std::vector<double> positions() const override {
    return vectors([&](std::int64_t row) { return liquid_.position(row); });
  }
  std::vector<double> velocities() const override {
    return vectors([&](std::int64_t row) { return liquid_.velocity(row); });
  }
  void set_positions(std::span<const Vec3> x, Places places) override {
    liquid_.check_inside(x);
    write(places, [&](std::int64_t row, std::size_t k) { liquid_.set_position(row, x[k]); });
  }
  void set_velocities(std::span<const Vec3> v, Places places) override {
    write(places, [&](std::int64_t row, std::size_t k) { liquid_.set_velocity(row, v[k]); });
  }
  void set_forces(std::span<const Vec3> f, Places places) override {
    auto forces = liquid_.forces;
    forces.resize(usize(size()));
    write(places, [&](std::int64_t row, std::size_t k) {
      for (std::size_t a = 0; a < D; ++a) {
        forces[usize(row)][a] = static_cast<Real>(f[k][static_cast<int>(a)]);
      }
    });
    liquid_.forces.swap(forces);
  }

  double time() const override { return liquid_.time; }
  void set_time(double time) override { liquid_.time = time; }
  int threads() const override { return liquid_.options.threads; }
  void set_threads(int threads) override { liquid_.options.threads = threads; }
  LiquidReport report() const override { return liquid_.report; }
  LiquidEnergies energies() const override { return liquid_.energies(); }
  double fastest() const override { return liquid_.fastest(); }
  const geometry::ParticleFlow::Counts& counts() const override { return liquid_.flow.counts; }

  std::vector<double> pressure() const override { return liquid_.pressure(); }
  std::vector<double> level_set() override {
    read_colliders();
    return liquid_.level_set();
  }
  std::vector<double> grid_velocity() override {
    read_colliders();
    return liquid_.grid_velocity();
  }

  LiquidState state() const override {
    const auto& p = liquid_.particles;
    const int affine = p.affine() ? D * D : 0;
    std::vector<Real> forces;
    for (const auto& force : liquid_.forces)
      forces.insert(forces.end(), force.begin(), force.end());
    std::vector<double> q;
    liquid_.layout.for_cells([&](std::int64_t i) { q.push_back(liquid_.q[usize(i)]); });
    LiquidState out{.time = liquid_.time,
                    .last_dt = liquid_.last_dt,
                    .next_id = liquid_.next_id,
                    .positions = rows(D, [&](int a) { return p.x(a); }),
                    .velocities = rows(D, [&](int a) { return p.v(a); }),
                    .affine = rows(affine, [&](int a) { return p.C(a / D, a % D); }),
                    .forces = std::move(forces),
                    .ids = {p.id(), p.id() + p.size()},
                    .pressure = std::move(q),
                    .flow = liquid_.flow.counts};
    std::vector<Real> deep_velocity;
    if (liquid_.band) liquid_.band->save(out.deep, deep_velocity);
    out.deep_velocity = std::move(deep_velocity);
    if (liquid_.band) out.seeded = liquid_.band->seeded, out.missing = liquid_.band->missing;
    return out;
  }
  void restore(const LiquidState& state) override {
    liquid_.flow.check(state.flow);
    const auto *x = std::get_if<std::vector<Real>>(&state.positions),
               *v = std::get_if<std::vector<Real>>(&state.velocities),
               *C = std::get_if<std::vector<Real>>(&state.affine),
               *f = std::get_if<std::vector<Real>>(&state.forces),
               *deep = std::get_if<std::vector<Real>>(&state.deep_velocity);
    if (x == nullptr || v == nullptr || C == nullptr || f == nullptr || deep == nullptr) {
      throw InputError("state: expected numbers of the liquid's own precision");
    }
    geometry::ParticleFlow::Counts counts = state.flow;
    Particles<Real, D> particles(liquid_.particles.affine());
    particles.append(static_cast<std::int64_t>(state.ids.size()), x->data(), v->data(),
                     C->empty() ? nullptr : C->data(), state.ids.data());
    std::vector<std::array<Real, D>> forces(f->size() / D);
    for (std::size_t i = 0; i < f->size(); ++i) forces[i / D][i % D] = (*f)[i];
    std::size_t k = 0;
    liquid_.particles = std::move(particles);
    liquid_.forces.swap(forces);
    liquid_.layout.for_cells([&](std::int64_t i) { liquid_.q[usize(i)] = state.pressure[k++]; });
    liquid_.flow.counts = std::move(counts);
    if (liquid_.band) {
      liquid_.band->restore(state.deep, *deep);
      liquid_.band->seeded = state.seeded;
      liquid_.band->missing = state.missing;
    }
    liquid_.time = state.time;
    liquid_.last_dt = state.last_dt;
    liquid_.next_id = state.next_id;
    liquid_.report = {};
  }

 private:
  void read_colliders() {
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      liquid_.obstacles.colliders[c] = *colliders_[c];
    }
  }
  std::vector<std::size_t> rows_of_ids() const {
    return rows_by_id({liquid_.particles.id(), usize(size())}, liquid_.next_id);
  }
  template <class Value>
  std::vector<double> vectors(const Value& value) const {
    std::vector<double> out;
    out.reserve(usize(size() * D));
    for (const std::size_t row : rows_of_ids()) {
      const Vec3 v = value(static_cast<std::int64_t>(row));
      out.insert(out.end(), v.data(), v.data() + D);
    }
    return out;
  }
  // put(row, k) of the k-th of the places.
  template <class Put>
  void write(Places places, const Put& put) {
    const std::vector<std::size_t> rows = rows_of_ids();
    for (std::size_t k = 0; k < places.size(); ++k) {
      put(static_cast<std::int64_t>(rows[usize(places[k])]), k);
    }
  }
  // In the order of storage: rows of the numbers in so many columns.
  template <class Column>
  std::vector<Real> rows(int columns, const Column& column) const {
    std::vector<Real> out(usize(size() * columns));
    for (int a = 0; a < columns; ++a) {
      const Real* const from = column(a);
      for (std::int64_t i = 0; i < size(); ++i) out[usize(i * columns + a)] = from[i];
    }
    return out;
  }

  GridLiquid<Real, D> liquid_;
  Colliders colliders_;
  geometry::KeptColliders kept_colliders_;
};

template <class Real>
std::unique_ptr<Liquid> make(Colliders colliders, const LiquidOptions& options,
                             geometry::ParticleFlow flow) {
  if (options.dimension == 2) {
    return std::make_unique<LiquidOf<Real, 2>>(std::move(colliders), options, std::move(flow));
  }
  return std::make_unique<LiquidOf<Real, 3>>(std::move(colliders), options, std::move(flow));
}

}  // namespace

std::unique_ptr<Liquid> make_liquid(Precision precision,
                                    std::vector<std::shared_ptr<geometry::Collider>> colliders,
                                    const LiquidOptions& options, geometry::ParticleFlow flow) {
  return precision == Precision::kSingle
             ? make<float>(std::move(colliders), options, std::move(flow))
             : make<double>(std::move(colliders), options, std::move(flow));
}

}  // namespace substep::gridfluid
