// Where particles come from and where they go: emitters let them out in layers, sinks swallow them,
// both at the end of a step and as a part of it.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "substep/geometry/collider.h"

namespace substep::geometry {

// Particles that came out.
struct Emitted {
  std::vector<Vec3> x, v;           // [m], [m/s]
  std::vector<std::int32_t> kinds;  // of the emitter
  std::vector<double> volumes;      // [m^3; in 2D m^2]
};

// A nozzle. Layer k leaves it at start + k thickness / speed; where it is at the end of a step does
// not depend on the steps.
struct Emitter {
  Vec3 position = Vec3::Zero(), direction = Vec3::UnitX();  // of length 1
  double speed = 1;                                         // [m/s]
  std::vector<Vec3> offsets;  // of the points of a layer from its middle [m]
  double thickness = 1;       // of a layer [m]
  double volume = 1;          // of a point
  std::int32_t kind = 0;
  double start = 0, stop = std::numeric_limits<double>::infinity();  // [s]

  // Layers, a whole number, that have left at a time, with that which leaves just then.
  double due(double time) const;
  // When the first layer after `layers` layers leaves that has not yet at a time.
  double next(std::int64_t layers, double time) const;
  // At `time`, what came since `layers` layers, which become those that have come then.
  Emitted let_out(std::int64_t& layers, double time) const;
};

// The emitters and sinks of a simulation, and what is its state of them.
struct ParticleFlow {
  struct Counts {
    std::vector<std::int64_t> layers, absorbed;  // let out by each emitter, swallowed by each sink
  };

  ParticleFlow() = default;
  ParticleFlow(std::vector<Emitter> taps, std::vector<std::shared_ptr<const Collider>> drains);

  bool any() const { return !emitters.empty() || !sinks.empty(); }
  // InputError: more than kMostAtOnce particles of an emitter are due at a time.
  void check(double time) const;
  // When an emitter lets out something next, after a time.
  double next(double time) const;
  // InputError: these are not of as many emitters and sinks.
  void check(const Counts& other) const;

  static constexpr std::int64_t kMostAtOnce = std::int64_t{1} << 22;

  std::vector<Emitter> emitters;
  std::vector<std::shared_ptr<const Collider>> sinks;  // what is inside is swallowed
  Counts counts;
};

}  // namespace substep::geometry
