#include "substep/geometry/particle_flow.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/usize.h"

namespace substep::geometry {

double Emitter::due(double time) const {
  if (!(time >= start)) return 0;
  const double gone = (std::min(time, stop) - start) * speed / thickness;
  return std::max(0.0, std::floor(gone + 1e-9) + 1);
}

double Emitter::next(std::int64_t layers, double time) const {
  const double k = std::max(static_cast<double>(layers), due(time));
  const double leaves = start + k * thickness / speed;
  return leaves <= stop ? leaves : std::numeric_limits<double>::infinity();
}

Emitted Emitter::let_out(std::int64_t& layers, double time) const {
  Emitted out;
  const auto last = static_cast<std::int64_t>(due(time));
  if (last <= layers) return out;
  const std::size_t n = usize(last - layers) * offsets.size();
  out.x.reserve(n);
  for (std::int64_t k = layers; k < last; ++k) {
    const double travelled = (time - start) * speed - thickness * static_cast<double>(k);
    const Vec3 middle = position + travelled * direction;
    for (const Vec3& offset : offsets) out.x.push_back(middle + offset);
  }
  out.v.assign(n, speed * direction);
  out.kinds.assign(n, kind);
  out.volumes.assign(n, volume);
  layers = last;
  return out;
}

ParticleFlow::ParticleFlow(std::vector<Emitter> taps,
                           std::vector<std::shared_ptr<const Collider>> drains)
    : emitters(std::move(taps)), sinks(std::move(drains)) {
  counts.layers.resize(emitters.size());
  counts.absorbed.resize(sinks.size());
}

void ParticleFlow::check(double time) const {
  for (std::size_t k = 0; k < emitters.size(); ++k) {
    const Emitter& emitter = emitters[k];
    const double layers = emitter.due(time) - static_cast<double>(counts.layers[k]);
    const auto points = static_cast<double>(emitter.offsets.size());
    if (layers * points <= static_cast<double>(kMostAtOnce)) continue;
    std::array<char, 320> why;
    std::snprintf(why.data(), why.size(),
                  "emitters[%zu]: %.4g layers of %.0f particles are due at %.6g s, above the %lld "
                  "particles that may come out in one step; it has been open since %.6g s: begin "
                  "at about the time of the simulation (start=), or take shorter steps",
                  k, layers, points, time, static_cast<long long>(kMostAtOnce), emitter.start);
    throw InputError(why.data());
  }
}

double ParticleFlow::next(double time) const {
  double soonest = std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k < emitters.size(); ++k) {
    const double leaves = emitters[k].next(counts.layers[k], time);
    if (leaves > time) soonest = std::min(soonest, leaves);
  }
  return soonest;
}

void ParticleFlow::check(const Counts& other) const {
  if (other.layers.size() != emitters.size() || other.absorbed.size() != sinks.size()) {
    throw InputError("state: expected that of an object with as many emitters and sinks");
  }
}

}  // namespace substep::geometry
