#include "substep/rigid/motion/splitting_rotation.h"

#include "substep/rigid/motion/free_rotation.h"

namespace substep::rigid {

namespace {

using V = Vector<double>;
constexpr int kLanes = sizeof(V) / sizeof(double);

// Column k of the first `count` of kLanes rows; the others are `rest`.
template <int kWidth>
V column(const double* rows, int k, int count, double rest) {
  V v = splat<V>(rest);
  for (int lane = 0; lane < count; ++lane) v[lane] = rows[kWidth * lane + k];
  return v;
}

// Up to kLanes bodies; the other lanes hold a body at rest.
SUBSTEP_INLINE void rotate_packet(int count, double* q, const double* L, const double* I,
                                  double dt) {
  const auto rows = [&](const double* from, double rest) {
    return Vector3<V>{{column<3>(from, 0, count, rest), column<3>(from, 1, count, rest),
                       column<3>(from, 2, count, rest)}};
  };
  const QuaternionLanes<V> next = split_rotation<V>(
      {column<4>(q, 0, count, 1),
       {{column<4>(q, 1, count, 0), column<4>(q, 2, count, 0), column<4>(q, 3, count, 0)}}},
      rows(L, 0), rows(I, 1), dt);
  for (int lane = 0; lane < count; ++lane) {
    q[4 * lane] = next.w[lane];
    for (int i = 0; i < 3; ++i) q[4 * lane + 1 + i] = next.v[i][lane];
  }
}

}  // namespace

void splitting_rows(std::int64_t n, double* q, const double* L, const double* inertia, double dt) {
  std::int64_t i = 0;
  for (; i + kLanes <= n; i += kLanes)
    rotate_packet(kLanes, q + 4 * i, L + 3 * i, inertia + 3 * i, dt);
  if (i < n) rotate_packet(static_cast<int>(n - i), q + 4 * i, L + 3 * i, inertia + 3 * i, dt);
}

Quaternion splitting_rotation(const Quaternion& q, const Vec3& L, const Vec3& inertia, double dt) {
  double row[4];
  store_quaternion(q, row);
  splitting_rows(1, row, L.data(), inertia.data(), dt);
  return load_quaternion(row);
}

}  // namespace substep::rigid
