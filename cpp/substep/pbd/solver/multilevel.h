// Multilevel position-based dynamics: before each sweep over the constraints, their error over many
// particles is removed on coarser and coarser levels. Sweeps alone carry a force one particle
// further at a time: of a large cloth that hangs by its corners they leave most of its weight
// uncarried, however small the step.
//
// A coarse particle I is the centre of mass of the fine ones that follow it, each with the part
// m_i / k_i of its mass where k_i coarse particles are its neighbours in the graph of distances:
//
//   X_I = sum_i (m_i / k_i) x_i / M_I,   M_I = sum_i m_i / k_i,   x_i += (1 / k_i) sum_I dX_I.
//
// So a coarse constraint is one on the fine positions, with the gradient and the masses that it has
// there: what it moves has neither a momentum nor a turning about the centre of mass (as has any
// constraint of distance). Pinned particles are kept on every level. As against Mueller 2008
// ("Hierarchical position based dynamics"), positions are averages instead of samples, and coarse
// constraints have no rest length of their own but the error of those that they stand for: with the
// strain e of the path of fine edges between the ends of a coarse one, |X_I - X_J| shall become
//
//   |X_I - X_J| / (1 + e), no further than to the distance d of I and J in the rest shape, nor away
//   from it
//
// as in the full approximation scheme (Brandt 1977, "Multi-level adaptive solutions to
// boundary-value problems", section 5). Where the fine constraints hold, coarse ones do nothing:
// cloth folds as freely as without, and the levels change how fast the solution is found, not
// which.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/core/lanes.h"
#include "substep/pbd/groups/colouring.h"
#include "substep/pbd/solver/coarsening.h"
#include "substep/pbd/solver/projector.h"

namespace substep::pbd {

template <class Real>
class Multilevel final : public Projector<Real> {
 public:
  // edges: constraints of distance that are rigid; rest: positions in which they hold; both with
  // the indices of the user.
  Multilevel(std::vector<DistanceGraph::Edge> edges, std::vector<std::array<double, 3>> rest);

  std::unique_ptr<Projector<Real>> clone() const override {
    return std::make_unique<Multilevel>(*this);
  }
  void attach(const Partition& partition) override;
  // One pass from the coarsest level to the finest; the sweep over the constraints comes after it.
  std::int64_t project(const Sweep<Real>& s, int threads) override;

  // Particles of each level, from the finest.
  std::vector<std::int64_t> level_sizes() const;

 private:
  using V = Vector<Real>;
  static constexpr int kLanes = sizeof(V) / sizeof(Real);
  static constexpr int kSteps = Coarsening::kSteps;
  struct alignas(kVectorBytes) Block {
    std::int32_t end[2][kLanes];
    Real rest[kLanes];    // d
    Real target[kLanes];  // what |X_I - X_J| shall become
  };
  struct alignas(kVectorBytes) Path {
    // Of the first coarse level: the points of the path; of the others: where the strains of its
    // edges are (block * kLanes + lane).
    std::int32_t index[kSteps + 1][kLanes];
    Real weight[kSteps][kLanes];  // length of each edge at rest / that of the path
    Real inverse_length[kLanes];  // 1 / length of the path at rest
  };
  // A coarse level, and how it hangs on the finer one.
  struct Level {
    std::int64_t size = 0;
    std::vector<Point<Real>> x, before;              // w: inverse mass; an empty row more
    Rows followed, members;                          // of Coarsening, in the order of slots
    std::vector<Real> member_weight, inverse_count;  // inverse_count: 1 / k_i
    std::vector<Block> blocks;
    std::vector<Path> paths;
    std::vector<Real> strain;  // e, by lanes of blocks
    Schedule schedule;
    int sweeps = 0;
  };
  enum class Kind : std::uint8_t { average, aim, patches, between, follow };
  struct Phase {
    Kind kind;
    std::size_t level;
    int group_phase = 0;
    std::int64_t chunks = 0;
  };

  void build(const Sweep<Real>& s);
  void add_level(const Coarsening& c, const DistanceGraph& fine_graph, const Partition& fine,
                 const Partition& coarse, std::vector<std::int32_t>& place);
  void add_constraints(const Coarsening& c, const DistanceGraph& fine_graph, const Partition& fine,
                       const Partition& coarse, std::vector<std::int32_t>& place, Level& level);
  void list_phases();
  void work(const Phase& phase, std::int64_t chunk, const Sweep<Real>& s);
  void average(std::size_t level, std::int64_t begin, std::int64_t end, const Sweep<Real>& s);
  void aim(std::size_t level, std::int64_t begin, std::int64_t end, const Sweep<Real>& s);
  void sweep(Level& level, std::int64_t begin, std::int64_t end);
  void follow(std::size_t level, std::int64_t begin, std::int64_t end, const Sweep<Real>& s);

  std::vector<DistanceGraph::Edge> edges_;
  std::vector<std::array<double, 3>> rest_;
  Partition partition_;
  std::vector<Real> inverse_mass_;  // by which the levels were built; slots
  std::vector<Level> levels_;
  std::vector<Phase> phases_;
  std::vector<std::int64_t> chunks_;  // of each phase
};

}  // namespace substep::pbd
