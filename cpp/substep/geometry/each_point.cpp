#include "substep/geometry/each_point.h"

#include <cstdint>

#include "substep/core/parallel.h"

namespace substep::geometry {

void for_each_point(std::span<const double> points, std::span<double> out,
                    const EachPoint& evaluate, int threads) {
  constexpr std::int64_t kGrain = 1024;  // points per task
  const auto count = static_cast<std::int64_t>(points.size() / 3);
  if (count == 0) return;
  const std::int64_t width = static_cast<std::int64_t>(out.size()) / count;
  parallel_for(
      count, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          const double* x = points.data() + 3 * i;
          evaluate(Vec3(x[0], x[1], x[2]), out.data() + width * i);
        }
      },
      threads);
}

}  // namespace substep::geometry
