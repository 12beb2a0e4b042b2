// Constraints that are a function of the user's, of `points` particles each: C and its gradient.
//
// A function takes `batch` constraints at once. Within a batch all are evaluated at the same
// positions, then projected one after the other, each with its C moved along by its gradient for
// what the ones before have moved: a Gauss-Seidel sweep over the constraints linearised there,
// which is stable however many share a particle. A batch of one (compiled functions) is the usual
// sweep.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "substep/pbd/groups/group.h"

namespace substep::pbd {

struct UserFunction {
  virtual ~UserFunction() = default;
  // x: positions of constraints [first, first + count), points x 3 numbers each; c: count numbers;
  // gradient: as x. Throws what the user's function throws.
  virtual void evaluate(std::int64_t first, std::int64_t count, const double* x, double* c,
                        double* gradient) = 0;
};

struct UserConstraints {
  std::shared_ptr<UserFunction> function;
  int points = 0;
  std::int64_t batch = 1;
  std::vector<std::int32_t> particles;      // `points` of each constraint
  std::array<double, 3> origin{};           // of the positions
  std::vector<double> compliance, damping;  // alpha and beta of each constraint (project.h)
  std::vector<double> stiffness;            // of each; below 1 for plain PBD
  bool inequality = false;                  // C >= 0: acts only while C < 0
};

template <class Real>
class UserGroup final : public Group<Real> {
 public:
  explicit UserGroup(UserConstraints constraints);

  std::unique_ptr<Group<Real>> clone() const override { return std::make_unique<UserGroup>(*this); }
  std::int64_t size() const override { return static_cast<std::int64_t>(lambda_.size()); }
  void attach(const Partition& partition) override;
  void begin_step(double h, int substeps, int iterations) override;
  int phases() const override { return 1; }
  std::int64_t chunks(int /*phase*/) const override { return 1; }
  bool serial() const override { return true; }
  std::int64_t project(int phase, std::int64_t chunk, const Sweep<Real>& sweep) override;
  void values(const Sweep<Real>& sweep, std::span<double> c) const override;
  void multipliers(std::span<double> lambda) const override;
  double energy(const Sweep<Real>& sweep) const override;

 private:
  // Evaluates a batch; throws NonFiniteError where C or a gradient is not finite.
  void evaluate(std::int64_t first, std::int64_t count, const Sweep<Real>& sweep,
                std::vector<double>& x, double* c, double* gradient) const;
  // Projects constraint j, evaluated at x; tells whether it was skipped.
  bool project_one(std::size_t j, const Sweep<Real>& sweep, const double* x, double c,
                   const double* gradient);

  UserConstraints constraints_;
  std::vector<std::int32_t> slot_;
  std::vector<double> lambda_, share_;  // share_: of a correction that is carried out
};

extern template class UserGroup<float>;
extern template class UserGroup<double>;

}  // namespace substep::pbd
