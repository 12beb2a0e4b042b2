// A flow of either precision and dimension, for those who choose them when they run: arrays over
// cells or faces in C order, without ghosts, and obstacles that its owner shares.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <vector>

#include "substep/core/numbers.h"
#include "substep/gridfluid/flow/flow_options.h"
#include "substep/gridfluid/flow/flow_sides.h"

namespace substep::gridfluid {

struct FlowState {
  double time = 0;                // [s]
  std::vector<Numbers> velocity;  // of the faces of each axis [m/s]
  std::vector<Numbers> scalars;   // of cells
  std::vector<double> pressure;   // of cells, over the density [m^2/s^2]
};

struct FlowBox {
  int dimension = 3;
  std::array<int, 3> cells{1, 1, 1};  // 2D: the first two
  Vec3 low = Vec3::Zero();            // lowest corner [m]
  double dx = 1;                      // a cell [m]
  std::array<std::array<Side, 2>, 3> sides;
};

class AnyGridFlow {
 public:
  virtual ~AnyGridFlow() = default;

  // As in Flow.
  virtual void step(double dt) = 0;
  virtual FlowSums sums() = 0;
  virtual FlowLimits limits() const = 0;
  virtual std::vector<double> sample(std::span<const Vec3> points) = 0;

  virtual int dimension() const = 0;
  virtual std::vector<double> velocities() const = 0;        // in the middle of cells [m/s]
  virtual std::vector<double> velocity(int axis) const = 0;  // of faces [m/s]
  virtual std::vector<double> scalar(int k) const = 0;       // of cells
  virtual std::vector<double> pressure() const = 0;          // [Pa]
  virtual std::vector<std::uint8_t> fluid() = 0;             // whether cells have any
  // Of the faces of each axis; what has a divergence is taken from them. Nothing changes where that
  // fails.
  virtual void set_velocity(const std::vector<std::vector<double>>& faces) = 0;
  virtual void project() = 0;  // that alone, of the velocities as they are
  virtual void set_scalar(int k, std::span<const double> values) = 0;

  virtual double time() const = 0;
  virtual void set_time(double time) = 0;
  virtual int threads() const = 0;
  virtual void set_threads(int threads) = 0;
  virtual FlowReport report() const = 0;
  virtual FlowState state() const = 0;
  // InputError: numbers of the other precision; nothing has changed then.
  virtual void restore(const FlowState& state) = 0;
};

// The colliders are read before each step, and moved by it.
std::unique_ptr<AnyGridFlow> make_flow(Precision precision, const FlowBox& box,
                                       std::vector<std::shared_ptr<geometry::Collider>> colliders,
                                       std::vector<FlowSource> sources, const FlowOptions& options);

}  // namespace substep::gridfluid
