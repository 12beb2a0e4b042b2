// Rows of bodies in lanes: as many as a vector of float64 has.
#pragma once

#include <cstdint>
#include <cstring>

#include "substep/core/matrix3.h"
#include "substep/core/point_scatter.h"
#include "substep/rigid/motion/body_rows.h"

namespace substep::rigid {

using LanesOfBodies = Vector<double>;

struct BodyLanes {
  Vector3<LanesOfBodies> linear, angular;
};

#if defined(__AVX512F__)
namespace detail {

// Of each pair of 128-bit blocks, those that the digits name: two of `x`, two of `y`.
template <int k>
SUBSTEP_INLINE LanesOfBodies blocks(const LanesOfBodies& x, const LanesOfBodies& y) {
  return reinterpret_cast<LanesOfBodies>(
      _mm512_shuffle_f64x2(reinterpret_cast<__m512d>(x), reinterpret_cast<__m512d>(y), k));
}

}  // namespace detail
#endif

// A row is one vector of AVX-512, so eight of them are a matrix to be transposed.
template <class At>
SUBSTEP_INLINE BodyLanes load_bodies(const At& at) {
  using V = LanesOfBodies;
#if defined(__AVX512F__)
  using substep::detail::pick_pair;
  V even[4], odd[4];  // x z x z x z x z ..., y w y w ...
  for (int k = 0; k < 4; ++k) {
    V p, q;
    std::memcpy(&p, at(2 * k), sizeof p), std::memcpy(&q, at(2 * k + 1), sizeof q);
    even[k] = pick_pair<0>(p, q), odd[k] = pick_pair<1>(p, q);
  }
  const V e0 = detail::blocks<0x44>(even[0], even[1]), e1 = detail::blocks<0xEE>(even[0], even[1]),
          e2 = detail::blocks<0x44>(even[2], even[3]), e3 = detail::blocks<0xEE>(even[2], even[3]),
          o0 = detail::blocks<0x88>(odd[0], odd[1]), o1 = detail::blocks<0x88>(odd[2], odd[3]);
  return {
      {{detail::blocks<0x88>(e0, e2), detail::blocks<0x88>(o0, o1), detail::blocks<0xDD>(e0, e2)}},
      {{detail::blocks<0x88>(e1, e3), detail::blocks<0xDD>(o0, o1), detail::blocks<0xDD>(e1, e3)}}};
#else
  const auto p = load_rows<V>([&](int lane) { return &at(lane)->linear; });
  const auto q = load_rows<V>([&](int lane) { return &at(lane)->angular; });
  return {{{p.x, p.y, p.z}}, {{q.x, q.y, q.z}}};
#endif
}

// The fourth numbers of rows become 0.
template <class At>
SUBSTEP_INLINE void store_bodies(const BodyLanes& m, const At& at) {
  using V = LanesOfBodies;
#if defined(__AVX512F__)
  using substep::detail::pick_pair;
  const auto to = [&](int row, const V& value) __attribute__((always_inline)) {
    std::memcpy(at(row), &value, sizeof value);
  };
  const auto store = [&](int row, const V& xy, const V& zw, const V& ab,
                         const V& cd) __attribute__((always_inline)) {
    const V p = detail::blocks<0x44>(xy, zw), q = detail::blocks<0xEE>(xy, zw);
    const V r = detail::blocks<0x44>(ab, cd), s = detail::blocks<0xEE>(ab, cd);
    to(row, detail::blocks<0x88>(p, r));
    to(row + 2, detail::blocks<0xDD>(p, r));
    to(row + 4, detail::blocks<0x88>(q, s));
    to(row + 6, detail::blocks<0xDD>(q, s));
  };
  const auto &v = m.linear, &w = m.angular;
  store(0, pick_pair<0>(v[0], v[1]), pick_pair<0>(v[2], V{}), pick_pair<0>(w[0], w[1]),
        pick_pair<0>(w[2], V{}));
  store(1, pick_pair<1>(v[0], v[1]), pick_pair<1>(v[2], V{}), pick_pair<1>(w[0], w[1]),
        pick_pair<1>(w[2], V{}));
#else
  store_rows<V>({m.linear[0], m.linear[1], m.linear[2], V{}},
                [&](int lane) { return &at(lane)->linear; });
  store_rows<V>({m.angular[0], m.angular[1], m.angular[2], V{}},
                [&](int lane) { return &at(lane)->angular; });
#endif
}

}  // namespace substep::rigid
