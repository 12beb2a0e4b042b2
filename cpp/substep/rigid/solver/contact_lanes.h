// What works on the contacts of a packet in lanes: conversions, products, and W^(1/2) of bodies.
#pragma once

#include <cstdint>

#include "substep/rigid/solver/contact_packet.h"

namespace substep::rigid {

// The compiler's own conversion goes by halves.
SUBSTEP_INLINE ContactPacket::V wide(const ContactPacket::F& x) {
#if defined(__AVX512F__)
  return reinterpret_cast<ContactPacket::V>(_mm512_cvtps_pd(reinterpret_cast<__m256>(x)));
#else
  return __builtin_convertvector(x, ContactPacket::V);
#endif
}
SUBSTEP_INLINE ContactPacket::V3 wide(const ContactPacket::F3& x) {
  return {{wide(x[0]), wide(x[1]), wide(x[2])}};
}
SUBSTEP_INLINE ContactPacket::F narrow(const ContactPacket::V& x) {
  return __builtin_convertvector(x, ContactPacket::F);
}
SUBSTEP_INLINE ContactPacket::F3 narrow(const ContactPacket::V3& x) {
  return {{narrow(x[0]), narrow(x[1]), narrow(x[2])}};
}

SUBSTEP_INLINE ContactPacket::V fused_dot(const ContactPacket::V3& x, const ContactPacket::V3& y) {
  return fma(x[0], y[0], fma(x[1], y[1], x[2] * y[2]));
}
SUBSTEP_INLINE ContactPacket::V3 fused_cross(const ContactPacket::V3& x,
                                             const ContactPacket::V3& y) {
  return {{fma(x[1], y[2], -(x[2] * y[1])), fma(x[2], y[0], -(x[0] * y[2])),
           fma(x[0], y[1], -(x[1] * y[0]))}};
}
// x + s y
SUBSTEP_INLINE ContactPacket::V3 fused_sum(const ContactPacket::V3& x, const ContactPacket::V& s,
                                           const ContactPacket::V3& y) {
  return {{fma(s, y[0], x[0]), fma(s, y[1], x[1]), fma(s, y[2], x[2])}};
}

// W^(1/2) v
struct RootLanes {
  using V = ContactPacket::V;
  using V3 = ContactPacket::V3;
  V xx, yy, zz, xy, xz, yz, scale, moves;

  SUBSTEP_INLINE RootLanes(const BodyRows& rows, const std::int32_t* index) {
    const auto d = load_rows<V>([&](int lane) { return &rows.root.data()[index[lane]].linear; });
    const auto m = load_rows<V>([&](int lane) { return &rows.root.data()[index[lane]].angular; });
    xx = d.x, yy = d.y, zz = d.z, scale = d.w;
    xy = m.x, xz = m.y, yz = m.z, moves = m.w;
  }
  SUBSTEP_INLINE V3 operator*(const V3& v) const {
    return {
        {fused_dot({{xx, xy, xz}}, v), fused_dot({{xy, yy, yz}}, v), fused_dot({{xz, yz, zz}}, v)}};
  }
};

}  // namespace substep::rigid
