// Advection on a grid: tiles of particles, in the order of the cells they are in, take many steps.
// A grid G has dimensions and numbers (kDimension, Scalar), says the rate of change at x and what
// is there, rate(slice, x, place, hint), where a Hint is what it remembers of a particle, and
// numbers blocks of cells, block(x) < block_count().
#pragma once

#include "substep/core/parallel.h"
#include "substep/fields/events.h"
#include "substep/fields/level.h"
#include "substep/fields/steps.h"

namespace substep::fields {

// Levels in rising time; one level alone is a steady field.
template <class T>
struct Series {
  std::vector<const Level<T>*> levels;
  std::vector<double> times;

  // Times before the first and after the last level take that level.
  Slice<T> at(double t) const;
};

// The particles: rows of x, what became of them (Place) and until when they moved [s].
template <class T>
struct Particles {
  T* x;
  std::int8_t* status;
  double* stop_time;
  const std::int32_t* order;  // a permutation, or null
  std::int64_t count;
};

template <class G>
using ScalarOf = typename G::Scalar;

// Moves the particles that are at sea. A step counts only if all its stages and its end are at sea
// and inside; otherwise the particle rests where the step began. With no steps, only looks where
// the particles are.
template <class G>
Events advect_grid(const G& grid, std::string_view method, const Series<ScalarOf<G>>& series,
                   const Particles<ScalarOf<G>>& particles, const Steps& steps, int threads);

// Permutation that brings particles of one block of cells together.
template <class G>
void sort_by_cell(const G& grid, const ScalarOf<G>* x, std::int64_t count, std::int32_t* order,
                  int threads);

// Velocities [data units] at x, NaN on land and outside.
template <class G>
void sample_grid(const G& grid, const Slice<ScalarOf<G>>& slice, const ScalarOf<G>* x,
                 ScalarOf<G>* u, std::int64_t count, int threads);

}  // namespace substep::fields
