// What a group of constraints (constraint_group.h) knows of the kernels of its constraint
// (project.h): so that all but them is compiled once.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "substep/core/lanes.h"
#include "substep/pbd/groups/group.h"

namespace substep::pbd {

enum class Softening { rigid, soft, damped };  // a = g = 0; g = 0; neither

// One number in each lane.
template <class Real>
struct alignas(kVectorBytes) RealLanes {
  Real values[kVectorBytes / sizeof(Real)];
};

// A number for each constraint, or the same for all.
template <class Real>
struct EachLane {
  const RealLanes<Real>* lanes;
  std::size_t stride;
  SUBSTEP_INLINE Vector<Real> operator[](std::size_t block) const {
    return substep::load<Vector<Real>>(lanes[block * stride].values);
  }
};

// How hard the constraints of a group are, and their lambda.
template <class Real>
struct LaneSoftness {
  Softening softening;
  EachLane<Real> compliance, damping, stiffness;  // alpha, beta, and the factor of dlambda
  RealLanes<Real>* multiplier;                    // null: not kept
  bool resume;                                    // lambda goes on from the last iteration
};

// Constraints are stored in blocks, one in each lane: the places of their particles, particle by
// particle and lane by lane, then their parameters in the same way. Where there are fewer than
// lanes, the last ones hold the empty particle.
template <class Real>
struct Kernels {
  static constexpr std::size_t kLanes = kVectorBytes / sizeof(Real);
  // Particles are named by where their row begins, in units of 8 bytes: an address is then one
  // instruction.
  static constexpr std::int64_t kUnits = sizeof(Point<Real>) / 8;

  // Vectors of a block, and where its parameters begin [bytes].
  static constexpr std::size_t lines(std::size_t points, std::size_t parameters) {
    const std::size_t bytes =
        first_parameter(points) + std::max(parameters, std::size_t{1}) * kVectorBytes;
    return (bytes + kVectorBytes - 1) / kVectorBytes;
  }
  static constexpr std::size_t first_parameter(std::size_t points) {
    return points * kLanes * sizeof(std::uint32_t);
  }

  std::size_t points, parameters;
  bool inequality;
  // Blocks [begin, end) of those that begin at `blocks`. Each returns how many constraints had no
  // gradient.
  std::int64_t (*project)(const void* blocks, std::size_t begin, std::size_t end,
                          const Sweep<Real>& s, const LaneSoftness<Real>& soft);
  std::int64_t (*correct)(const void* blocks, std::size_t begin, std::size_t end,
                          const Sweep<Real>& s, const LaneSoftness<Real>& soft, Point<Real>* rows);
  void (*values)(const void* block, const Point<Real>* x, Real* c);
};

// Those of the constraint of that name: project_float.cpp, project_double.cpp.
template <class Real>
Kernels<Real> find_kernels(std::string_view name);
template <>
Kernels<float> find_kernels(std::string_view name);
template <>
Kernels<double> find_kernels(std::string_view name);

}  // namespace substep::pbd
