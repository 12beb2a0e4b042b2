// A field on a grid (grid.h) for those who choose its dimension and precision when they run.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "substep/core/numbers.h"
#include "substep/fields/axis.h"
#include "substep/fields/cells.h"
#include "substep/fields/events.h"
#include "substep/fields/steps.h"

namespace substep::fields {

// One level in time.
class AnyLevel {
 public:
  virtual ~AnyLevel() = default;
};

struct AnySeries {
  std::vector<const AnyLevel*> levels;
  std::vector<double> times;
};

struct AnyParticles {
  NumbersOut x;  // rows
  std::span<std::int8_t> status;
  std::span<double> stop_time;
  const std::int32_t* order;  // a permutation, or null
};

// Positions and levels are of the grid's precision; InputError otherwise.
class AnyGrid {
 public:
  virtual ~AnyGrid() = default;
  virtual std::int64_t level_bytes() const = 0;
  virtual std::unique_ptr<AnyLevel> pack(const double* values, int threads) const = 0;
  virtual void order(NumbersIn x, std::int32_t* out, int threads) const = 0;
  virtual void velocity(const AnySeries& series, double t, NumbersIn x, NumbersOut u,
                        int threads) const = 0;
  virtual Events advect(const std::string& method, const AnySeries& series,
                        const AnyParticles& particles, const Steps& steps, int threads) const = 0;
};

// As Grid's constructor, with as many axes as the grid has dimensions, two or three.
std::unique_ptr<AnyGrid> make_grid(Precision precision, const std::vector<Axis>& axes, bool cubic,
                                   double radius);
// As CurvilinearGrid's; in two dimensions where z is empty.
std::unique_ptr<AnyGrid> make_curvilinear_grid(Precision precision, const Corners& corners,
                                               const std::vector<double>& z, Staggering staggering,
                                               double radius);

}  // namespace substep::fields
