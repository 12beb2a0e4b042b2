// The layers of an emitter that have not come out yet, as a wall that moves with them. A layer that
// comes out has nothing behind it otherwise: the least density error drives it back, the next one
// comes out into it, and the error grows from layer to layer until the jet bursts. SPlisHSPlasH
// holds the particles in its nozzles likewise, those of two supports.
//
// b = v sum_j W(|x - x_j|) over the points x_j of the layers, but for those that are in obstacles,
// which count as filled anyway.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "substep/geometry/particle_flow.h"
#include "substep/pbf/wall_integrals.h"

namespace substep::pbf {

class Nozzle {
 public:
  // value, slope: v W and v W', 0 from h on.
  Nozzle(const geometry::Emitter& emitter, const KernelFunction& value, const KernelFunction& slope,
         double h);

  // The layers at a time when so many have become particles; none before the emitter begins.
  void place(std::int64_t layers, double time);
  // Whether a point of them may be nearer than `reach`.
  bool near(const Vec3& x, double reach) const;
  void leave_out(const std::function<bool(const Vec3&)>& covered);

  WallDensity density(const Vec3& x) const;
  Vec3 velocity() const { return emitter_.speed * emitter_.direction; }

 private:
  template <class Visit>
  void for_points(const Vec3& x, const Visit& visit) const;

  geometry::Emitter emitter_;
  KernelFunction value_, slope_;
  double h_;
  // The points of a layer in a raster of cells across, and where the layers are [m].
  Vec3 across_[2];
  double low_[2], high_[2];
  std::int64_t cells_[2];
  std::vector<std::int64_t> first_;
  std::vector<std::size_t> order_;
  std::vector<double> travelled_;
  std::vector<std::uint8_t> left_out_;  // by layer and point
};

}  // namespace substep::pbf
