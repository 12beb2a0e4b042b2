// Where bodies slide from one onto the next whose face lies in the same plane, its seam stops none.
//
// A body A lies on B, and C ends at the plane between A and B: A and C, which are apart by that
// plane, cannot meet but along its normal. Yet the nearest points of two that are beside each other
// are on their edges, and the least overlap of what has just come over an edge is across it: such a
// contact would stop A as a step does. A plane parts them where neither is beyond it by more than
// bodies that touch overlap, and neither comes out of it in the step.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/incidence.h"
#include "substep/core/usize.h"
#include "substep/rigid/world/fixtures.h"

namespace substep::rigid {

class Seams {
 public:
  // Of two fixtures that approach along the normal, neither of which is a ball or a plane, and
  // which touch on edges.
  struct Edge {
    std::int32_t a, b;
    Vec3 normal;
    std::int32_t touch;  // its number in the chunk of pairs
  };
  // Of two fixtures that touch: the plane n . x = level between them.
  struct Face {
    std::int32_t a, b;
    Vec3 normal;  // from a to b
    double level;
  };

  // How near bodies are that touch, of the distance at which contacts begin.
  static constexpr double kFlush = 0.125;

  // each_face(has_edge, visit) calls visit(face) for all faces with has_edge(a) or has_edge(b), the
  // numbers of its fixtures.
  template <class EachFace>
  void begin(std::span<const std::vector<Edge>> edges, const Fixtures& fixtures,
             std::int64_t bodies, const EachFace& each_face) {
    has_edge_.assign(usize(bodies), 0);
    for (const auto& of_chunk : edges)
      for (const Edge& edge : of_chunk)
        for (const std::int32_t f : {edge.a, edge.b}) has_edge_[usize(fixtures[f].body)] = 1;
    faces_.clear();
    each_face([&](std::int32_t f) { return has_edge_[usize(fixtures[f].body)] != 0; },
              [&](const Face& face) { faces_.push_back(face); });
    of_body_.assign(bodies, [&](const auto& visit) {
      for (std::size_t k = faces_.size(); k-- > 0;)
        for (const std::int32_t f : {faces_[k].a, faces_[k].b})
          visit(fixtures[f].body, static_cast<std::int32_t>(k));
    });
  }

  // Whether a plane on which one of the two lies parts them for this step.
  bool parted(const Edge& edge, const Fixtures& fixtures, std::span<const Way> ways) const;

 private:
  std::vector<std::uint8_t> has_edge_;  // of each body
  std::vector<Face> faces_;
  Incidence of_body_;  // its faces
};

}  // namespace substep::rigid
