// A group of constraints that are formulas (constraint.h), swept in the order of colouring.h by the
// kernels of project.h.
#pragma once

#include "substep/pbd/groups/colouring.h"
#include "substep/pbd/groups/kernels.h"

namespace substep::pbd {

template <class Real>
class ConstraintGroup final : public Group<Real> {
  using Lanes = RealLanes<Real>;
  static constexpr std::size_t kLanes = Kernels<Real>::kLanes;
  static constexpr std::size_t kCorrectionBlocks = 128;  // per task

 public:
  // particles: points for each constraint; parameters: their number for each.
  ConstraintGroup(const Kernels<Real>& kernels, std::vector<std::int32_t> particles,
                  std::vector<double> parameters, Softness softness);

  std::unique_ptr<Group<Real>> clone() const override;
  std::int64_t size() const override { return size_; }
  void attach(const Partition& partition) override;
  void begin_step(double h, int substeps, int iterations) override;

  std::int64_t project_patch(std::int64_t patch, const Sweep<Real>& s) override;
  int phases() const override { return schedule_.phases(); }
  std::int64_t chunks(int phase) const override;
  std::int64_t project(int phase, std::int64_t chunk, const Sweep<Real>& s) override;

  std::vector<std::int32_t> holders() const override;
  std::int64_t correction_chunks() const override;
  std::int64_t correct(std::int64_t chunk, const Sweep<Real>& s, Point<Real>* rows) override;

  void values(const Sweep<Real>& s, std::span<double> c) const override;
  void multipliers(std::span<double> lambda) const override;
  double energy(const Sweep<Real>& s) const override;

 private:
  std::size_t block_count() const { return schedule_.constraint.size() / kLanes; }
  std::vector<Lanes> in_blocks(const std::vector<double>& values) const;
  LaneSoftness<Real> softness(const Sweep<Real>& s);
  std::int64_t project_blocks(std::int64_t begin, std::int64_t end, const Sweep<Real>& s);
  template <class Function>
  void for_lanes(std::size_t b, Function&& function) const;

  Kernels<Real> kernels_;
  std::vector<std::int32_t> particles_;  // until attach()
  std::vector<double> parameters_;
  Softness softness_;
  std::int64_t size_;
  std::size_t lines_;  // of a block
  Softening softening_ = Softening::rigid;
  Schedule schedule_;
  std::vector<Lanes> blocks_;
  std::vector<Lanes> compliance_, damping_, stiffness_, multiplier_;
};

}  // namespace substep::pbd
