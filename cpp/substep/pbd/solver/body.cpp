#include "substep/pbd/solver/body.h"

#include <array>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/geometry/kept_colliders.h"
#include "substep/pbd/solver/dynamics.h"
#include "substep/pbd/solver/multilevel.h"

namespace substep::pbd {
namespace {

std::vector<geometry::Collider> copies(const Body::Colliders& colliders) {
  std::vector<geometry::Collider> out;
  for (const auto& collider : colliders) out.push_back(*collider);
  return out;
}

template <class Real>
const std::vector<Real>& own(const Numbers& numbers) {
  if (const auto* given = std::get_if<std::vector<Real>>(&numbers)) return *given;
  throw InputError("state: expected numbers of the simulation's own precision");
}

template <class Real>
std::vector<std::unique_ptr<Group<Real>>> groups_of(std::span<const Recipe* const> recipes) {
  std::vector<std::unique_ptr<Group<Real>>> groups;
  for (const Recipe* recipe : recipes) {
    if constexpr (std::is_same_v<Real, float>) {
      groups.push_back(recipe->in_single());
    } else {
      groups.push_back(recipe->in_double());
    }
  }
  return groups;
}

template <class Real>
class BodyOf final : public Body {
 public:
  template <class... Arguments>
  explicit BodyOf(Colliders colliders, Arguments&&... arguments)
      : dynamics_(std::forward<Arguments>(arguments)...), colliders_(std::move(colliders)) {}

  std::unique_ptr<Body> copy(Colliders colliders) const override {
    return std::make_unique<BodyOf>(std::move(colliders), dynamics_);
  }
  void use_multilevel(std::span<const std::int32_t> pairs, std::span<const double> lengths,
                      Rows rest) override {
    std::vector<DistanceGraph::Edge> edges;
    edges.reserve(lengths.size());
    for (std::size_t k = 0; k < lengths.size(); ++k)
      edges.push_back({pairs[2 * k], pairs[2 * k + 1], lengths[k]});
    auto solver =
        std::make_unique<Multilevel<Real>>(std::move(edges), std::vector(rest.begin(), rest.end()));
    solver->attach(dynamics_.partition());
    dynamics_.projector = std::move(solver);
  }
  std::vector<std::int64_t> level_sizes() const override {
    const auto* solver = dynamic_cast<const Multilevel<Real>*>(dynamics_.projector.get());
    return solver ? solver->level_sizes() : std::vector<std::int64_t>{};
  }

  void step(double dt) override {
    if (!dynamics_.contact) return dynamics_.step(dt);
    std::vector<geometry::Collider>& moved = dynamics_.contact->colliders;
    for (std::size_t c = 0; c < colliders_.size(); ++c) moved[c] = *colliders_[c];
    dynamics_.step(dt);
    for (std::size_t c = 0; c < colliders_.size(); ++c) *colliders_[c] = moved[c];
  }
  double time() const override { return dynamics_.time; }
  void set_time(double time) override { dynamics_.time = time; }
  void keep() override {
    read_raw(kept_.values);
    kept_.forces.resize(usize(dynamics_.size()));
    dynamics_.forces(kept_.forces);
    kept_.groups.resize(dynamics_.groups());
    for (std::size_t g = 0; g < groups(); ++g) kept_.groups[g] = group_state(g);
    kept_.time = time();
    kept_.colliders.keep(colliders_);
  }
  void rewind() override {
    dynamics_.set_raw(kept_.values[0], kept_.values[1], kept_.values[2]);
    dynamics_.set_forces(kept_.forces);
    for (std::size_t g = 0; g < groups(); ++g) set_group_state(g, kept_.groups[g]);
    set_time(kept_.time);
    kept_.colliders.rewind(colliders_);
  }
  int threads() const override { return dynamics_.options.threads; }
  void set_threads(int threads) override { dynamics_.options.threads = threads; }
  Triple origin() const override { return dynamics_.origin(); }
  std::int64_t skipped() const override { return dynamics_.skipped(); }
  double last_substep() const override { return dynamics_.last_substep(); }
  double elastic_energy() const override { return dynamics_.elastic_energy(); }

  std::vector<double> positions() const override { return rows(&Dynamics<Real>::positions); }
  std::vector<double> velocities() const override { return rows(&Dynamics<Real>::velocities); }
  std::vector<double> forces() const override { return rows(&Dynamics<Real>::forces); }
  std::vector<double> targets() const override { return rows(&Dynamics<Real>::targets); }
  std::vector<std::uint8_t> pinned() const override { return dynamics_.pinned(); }
  void set_positions(Ids ids, Rows values) override { dynamics_.set_positions(ids, values); }
  void set_velocities(Ids ids, Rows values) override { dynamics_.set_velocities(ids, values); }
  void set_forces(Rows values) override { dynamics_.set_forces(values); }
  void set_targets(Rows values) override { dynamics_.set_targets(values); }
  void set_pinned(std::span<const std::uint8_t> pinned) override { dynamics_.set_pinned(pinned); }

  Raw raw() const override {
    RawValues values;
    read_raw(values);
    auto& [x, v, targets] = values;
    return {std::move(x), std::move(v), std::move(targets)};
  }
  void set_raw(const Raw& raw) override {
    dynamics_.set_raw(own<Real>(raw.positions), own<Real>(raw.velocities), own<Real>(raw.targets));
  }

  std::size_t groups() const override { return dynamics_.groups(); }
  std::vector<double> values(std::size_t group) override {
    std::vector<double> c(usize(dynamics_.group(group).size()));
    dynamics_.values(group, c);
    return c;
  }
  std::vector<double> multipliers(std::size_t group) override {
    std::vector<double> lambda(usize(dynamics_.group(group).size()));
    dynamics_.multipliers(group, lambda);
    return lambda;
  }
  std::vector<double> group_state(std::size_t group) override {
    return dynamics_.group(group).state();
  }
  void set_group_state(std::size_t group, std::span<const double> state) override {
    dynamics_.group(group).restore(state);
  }

 private:
  using RawValues = std::array<std::vector<Real>, 3>;  // positions, velocities, targets
  void read_raw(RawValues& values) const {
    auto& [x, v, targets] = values;
    const auto n = 3 * usize(dynamics_.size());
    x.resize(n);
    v.resize(n);
    targets.resize(dynamics_.has_targets() ? n : 0);
    dynamics_.raw(x, v, targets);
  }
  std::vector<double> rows(void (Dynamics<Real>::*get)(std::span<Triple>) const) const {
    std::vector<Triple> rows(usize(dynamics_.size()));
    (dynamics_.*get)(rows);
    std::vector<double> out;
    out.reserve(3 * rows.size());
    for (const Triple& row : rows) out.insert(out.end(), row.begin(), row.end());
    return out;
  }

  Dynamics<Real> dynamics_;
  Colliders colliders_;
  struct {
    RawValues values;
    std::vector<Triple> forces;
    std::vector<std::vector<double>> groups;
    double time = 0;
    geometry::KeptColliders colliders;
  } kept_;
};

}  // namespace

std::unique_ptr<Body> make_body(Precision precision, Body::Rows positions, Body::Rows velocities,
                                std::span<const double> masses,
                                std::span<const std::uint8_t> pinned,
                                std::span<const Recipe* const> groups, Body::Colliders colliders,
                                const Options& options) {
  const auto make = [&]<class Real>(Real) -> std::unique_ptr<Body> {
    std::vector<geometry::Collider> obstacles = copies(colliders);
    return std::make_unique<BodyOf<Real>>(std::move(colliders), positions, velocities, masses,
                                          pinned, groups_of<Real>(groups), std::move(obstacles),
                                          options);
  };
  return precision == Precision::kSingle ? make(float{}) : make(double{});
}

}  // namespace substep::pbd
