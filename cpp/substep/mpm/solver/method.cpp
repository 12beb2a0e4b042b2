#include "substep/mpm/solver/method.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/geometry/kept_colliders.h"
#include "substep/mpm/solver/solver.h"

namespace substep::mpm {
namespace {

using geometry::Collider;
using Colliders = std::vector<std::shared_ptr<Collider>>;

std::vector<Collider> copies(const Colliders& colliders) {
  std::vector<Collider> out;
  for (const auto& collider : colliders) out.push_back(*collider);
  return out;
}

template <class Real>
const std::vector<Real>& own(const Numbers& numbers) {
  if (const auto* given = std::get_if<std::vector<Real>>(&numbers)) return *given;
  throw InputError("state: expected numbers of the object's own precision");
}

template <class T>
void append(std::vector<T>& to, const std::vector<T>& from) {
  to.insert(to.end(), from.begin(), from.end());
}

template <class Real, int D>
class MethodOf final : public Method {
 public:
  MethodOf(Options options, Colliders colliders, geometry::ParticleFlow flow)
      : solver_(std::move(options), copies(colliders), std::move(flow)),
        colliders_(std::move(colliders)) {}

  std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v,
                   std::span<const std::int32_t> material,
                   std::span<const double> volume) override {
    return solver_.add(x, v, material, volume);
  }
  void remove(Places places) override {
    std::vector<std::uint8_t> flags(usize(solver_.size()));
    for (const std::int64_t place : places) flags[usize(place)] = 1;
    solver_.remove(flags);
  }
  void step(double dt) override {
    run([&] { solver_.step(dt); });
  }
  void step_by_limit() override {
    run([&] { solver_.step_by_limit(); });
  }
  void advance(double end) override {
    run([&] { solver_.advance(end); });
  }
  void advance_once(double end, bool first) override {
    const bool goes_on = !first && leg_;
    if (!goes_on) leg_ = solver_.next_leg(end);
    run([&] { solver_.advance_once(*leg_, goes_on); });
    if (time() >= leg_->end) leg_.reset();
  }
  void keep() override {
    kept_ = state();
    kept_colliders_.keep(colliders_);
  }
  void rewind() override {
    restore(kept_);
    kept_colliders_.rewind(colliders_);
  }
  StepLimit step_limit() const override { return solver_.step_limit(); }

  int dimension() const override { return D; }
  std::int64_t size() const override { return solver_.size(); }
  std::vector<std::int64_t> ids() const override { return solver_.ids(); }
  std::vector<std::int32_t> materials() const override { return solver_.materials(); }
  std::vector<double> positions() const override { return solver_.positions(); }
  std::vector<double> velocities() const override { return solver_.velocities(); }
  std::vector<double> affine() const override { return solver_.affine(); }
  std::vector<double> volumes() const override { return solver_.volumes(); }
  std::vector<double> stresses() const override { return solver_.stresses(); }
  std::vector<double> elastic_energies() const override { return solver_.elastic_energies(); }
  std::vector<double> material_fields(int material) const override {
    return solver_.material_fields(material);
  }
  int field_count(int material) const override { return solver_.field_count(material); }
  void set_positions(std::span<const Vec3> x, Places places) override {
    solver_.set_positions(x, places);
  }
  void set_velocities(std::span<const Vec3> v, Places places) override {
    solver_.set_velocities(v, places);
  }
  void set_forces(std::span<const Vec3> forces, Places places) override {
    solver_.set_forces(forces, places);
  }
  void set_affine(std::span<const double> C, Places places) override {
    solver_.set_affine(C, places);
  }
  void set_material_fields(int material, std::span<const double> fields, Places places) override {
    solver_.set_material_fields(material, fields, places);
  }

  double time() const override { return solver_.time(); }
  void set_time(double time) override { solver_.set_time(time); }
  int threads() const override { return solver_.threads(); }
  void set_threads(int threads) override { solver_.set_threads(threads); }
  Report report() const override { return solver_.report(); }
  Diagnostics diagnostics() const override { return solver_.diagnostics(); }
  const geometry::ParticleFlow::Counts& counts() const override { return solver_.flow().counts; }

  MethodState state() const override {
    MethodState state;
    state.clock = solver_.clock();
    state.forces = solver_.forces();
    state.flow = solver_.flow().counts;
    std::vector<Real> values, motion, volumes;
    for (const ParticleRows<Real, D>& group : solver_.rows()) {
      state.counts.push_back(static_cast<std::int64_t>(group.ids.size()));
      append(state.ids, group.ids);
      for (const auto& block : group.blocks)
        state.blocks.insert(state.blocks.end(), block.begin(), block.end());
      append(values, group.state);
      append(motion, group.motion);
      append(volumes, group.volume);
    }
    state.values = std::move(values);
    state.motion = std::move(motion);
    state.volumes = std::move(volumes);
    return state;
  }
  void restore(const MethodState& state) override {
    check_sizes(state);
    std::vector<ParticleRows<Real, D>> groups(state.counts.size());
    const std::int32_t *id = state.ids.data(), *block = state.blocks.data();
    const Real *value = own<Real>(state.values).data(), *v = own<Real>(state.motion).data(),
               *volume = own<Real>(state.volumes).data();
    for (std::size_t g = 0; g < groups.size(); ++g) {
      const std::int64_t count = state.counts[g], width = count * width_of(g);
      groups[g].ids.assign(id, id + count);
      for (std::int64_t i = 0; i < count; ++i, block += D) {
        transfer::Index<D> at;
        std::copy_n(block, D, at.begin());
        groups[g].blocks.push_back(at);
      }
      groups[g].state.assign(value, value + width);
      groups[g].motion.assign(v, v + count * kMotion);
      groups[g].volume.assign(volume, volume + count);
      id += count, volume += count, value += width, v += count * kMotion;
    }
    solver_.restore(state.clock, groups, state.forces, state.flow);
  }

 private:
  static constexpr int kMotion = ParticleGroup<Real, D>::kMotion;

  template <class Steps>
  void run(const Steps& steps) {
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      if (colliders_[c]->yields() && solver_.options().integrator == Integrator::kImplicit) {
        throw InputError("colliders[" + std::to_string(c) +
                         "]: expected one that is moved by hand with "
                         "integrator=\"implicit_euler\", got one of a body that yields");
      }
    }
    for (std::size_t c = 0; c < colliders_.size(); ++c) solver_.colliders()[c] = *colliders_[c];
    try {
      steps();
    } catch (...) {
      write_colliders();
      throw;
    }
    write_colliders();
  }
  void write_colliders() {
    for (std::size_t c = 0; c < colliders_.size(); ++c) *colliders_[c] = solver_.colliders()[c];
  }

  std::int64_t width_of(std::size_t group) const {
    return D + solver_.field_count(static_cast<int>(group));
  }
  void check_sizes(const MethodState& state) const {
    if (state.counts.size() != solver_.options().materials.size()) {
      throw InputError("state['counts']: expected one number per material");
    }
    const auto size = [](const auto& values) { return static_cast<std::int64_t>(values.size()); };
    std::int64_t n = 0, numbers = 0;
    for (std::size_t g = 0; g < state.counts.size(); ++g) {
      const std::int64_t count = state.counts[g];
      if (count < 0 || count > size(state.ids)) {
        throw InputError("state['counts']: expected the numbers of the particles");
      }
      n += count;
      numbers += count * width_of(g);
    }
    if (n != size(state.ids) || size(state.blocks) != n * D ||
        size(own<Real>(state.values)) != numbers || size(own<Real>(state.motion)) != n * kMotion ||
        size(own<Real>(state.volumes)) != n || (!state.forces.empty() && size(state.forces) != n)) {
      throw InputError("state: expected arrays of as many particles as there are ids");
    }
  }

  Solver<Real, D> solver_;
  Colliders colliders_;
  std::optional<Leg> leg_;  // that advance_once() is in
  MethodState kept_;
  geometry::KeptColliders kept_colliders_;
};

}  // namespace

std::unique_ptr<Method> make_method(Precision precision, int dimension, const Settings& settings,
                                    const std::vector<MaterialConstants>& materials,
                                    std::vector<std::shared_ptr<Collider>> colliders,
                                    geometry::ParticleFlow flow) {
  Options options{settings, make_materials(materials)};
  const auto make = [&]<class Real>(Real) -> std::unique_ptr<Method> {
    if (dimension == 2)
      return std::make_unique<MethodOf<Real, 2>>(std::move(options), std::move(colliders),
                                                 std::move(flow));
    return std::make_unique<MethodOf<Real, 3>>(std::move(options), std::move(colliders),
                                               std::move(flow));
  };
  return precision == Precision::kSingle ? make(float{}) : make(double{});
}

}  // namespace substep::mpm
