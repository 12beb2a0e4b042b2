// Contact of a surface with itself: a thickness, friction, and no passing through.
//
// Pairs (surface_pairs.h) that may meet in a substep get the direction n from one part's closest
// point to the other's when the substep began, when they were apart. Along n a slab lies between
// the two, and as long as it does not vanish they cannot meet, whatever they do besides: all paths
// of a substep are straight, so it is enough that the slab is there at the end.
//
//   Thickness. C = n . sum_i w_i x_i - t >= 0, an inequality whose gradients w_i n are constant,
//   with t the thickness, or 0.99 of the distance at rest where that is less (so that a flat sheet
//   exerts nothing on itself). Corrections are shared by inverse masses, as of any constraint
//   (Mueller et al. 2007). Friction. Of the tangential way s = (1 - n n^T) sum_i w_i (x_i -
//   x_i^old) a correction takes min(1, friction |C| / |s|) away (Macklin et al., "Unified particle
//   physics", 2014, eq. 24). The slab. After everything else, where for a pair min over one side of
//   n . x less max over the other is below a part of what it was, the two vertices in question are
//   pushed apart along n; what that leaves is brought back towards the mean motion of the surface,
//   in halves, until it is there. In that motion all slabs are as they were, so this ends. No
//   vertex moves by more than `limit` from the mean motion, so that pairs further apart than twice
//   that need not be watched.
//
// Deviations from the paths of Harmon et al. ("Robust treatment of simultaneous collisions", 2008):
// slabs in place of cubic equations for the times of impact, which are exact only up to rounding;
// they stop some vertices that would just have missed. Held particles are not brought back: cloth
// may be pulled through itself by them, and is then left so; passed() counts these pairs.
//
// Contacts are projected one after the other, in the order of the list, on the calling thread;
// finding them is parallel.
#pragma once

#include <atomic>

#include "substep/pbd/contact/surface_pairs.h"
#include "substep/pbd/groups/group.h"

namespace substep::pbd {

struct SelfContactOptions {
  double thickness;     // [m]
  double friction = 0;  // Coulomb's coefficient
};

template <class Real>
class SelfContact : public Group<Real> {
 public:
  // faces: triangles of particles, by the indices of the user, whose positions are `rest`.
  SelfContact(std::vector<std::array<std::int32_t, 3>> faces, std::vector<geometry::Vec3> rest,
              const SelfContactOptions& options);

  std::unique_ptr<Group<Real>> clone() const override;
  std::int64_t size() const override { return 0; }  // contacts come and go
  void attach(const Partition& partition) override;
  bool prepares() const override { return true; }
  void prepare(const Sweep<Real>& s, int threads) override;
  bool serial() const override { return true; }
  int phases() const override { return 1; }
  std::int64_t chunks(int) const override { return 1; }
  std::int64_t project(int phase, std::int64_t chunk, const Sweep<Real>& s) override;
  void complete(const Sweep<Real>& s, int threads) override;

  // Pairs of the last substep whose slab vanished because of held particles.
  std::int64_t passed() const { return passed_; }

 private:
  using Vec3 = geometry::Vec3;

  struct Contact {
    SurfacePair pair;
    std::array<Real, 4> w;
    std::array<Real, 3> n;
    Real thickness;
  };
  struct Meeting {
    SurfacePair pair;
    std::array<Real, 3> n;
    double least;  // width of the slab at the end
  };
  // The vertices at the two sides of the slab, and its width.
  struct Slab {
    std::int32_t high, low;
    double width;
  };

  double take_deviations(const Sweep<Real>& s);
  bool could_come_within(const typename SurfacePairs<Real>::Candidate& c, double distance,
                         const Sweep<Real>& s) const;
  template <class Kept, class Keep>
  void collect(std::vector<Kept>& kept, int threads, Keep&& keep) const;
  static Slab slab(const SurfacePair& pair, const std::array<Real, 3>& n, const Point<Real>* x);
  void limit(const Sweep<Real>& s, std::int32_t v) const;
  bool find_meetings(const Sweep<Real>& s, int threads);
  bool push_apart(const Sweep<Real>& s) const;
  void bring_back(const Sweep<Real>& s);

  std::vector<std::array<std::int32_t, 3>> faces_;
  std::vector<Vec3> rest_;
  SelfContactOptions options_;
  std::vector<SurfacePairs<Real>> pairs_;  // one, once attached
  std::vector<Contact> contacts_;
  std::vector<Meeting> meetings_;
  Vec3 mean_ = Vec3::Zero();      // motion of this substep
  std::vector<Real> deviations_;  // of each particle from it
  double limit_ = 0, reach_ = 0;
  std::vector<Point<Real>> wanted_;  // bring_back: where particles were to go,
  std::vector<int> halvings_;        // and how often they were brought back
  std::int64_t passed_ = 0;
};

}  // namespace substep::pbd
