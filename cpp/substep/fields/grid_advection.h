// Advection on a grid: tiles of particles, in the order of the cells they are in, take many steps.
#pragma once

#include "substep/core/parallel.h"
#include "substep/fields/events.h"
#include "substep/fields/grid.h"
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

// Moves the particles that are at sea. A step counts only if all its stages and its end are at sea
// and inside; otherwise the particle rests where the step began. With no steps, only looks where
// the particles are.
template <class T, int kDim>
Events advect_grid(const Grid<T, kDim>& grid, std::string_view method, const Series<T>& series,
                   const Particles<T>& particles, const Steps& steps, int threads);

// Permutation that brings particles of one block of cells together.
template <class T, int kDim>
void sort_by_cell(const Grid<T, kDim>& grid, const T* x, std::int64_t count, std::int32_t* order,
                  int threads);

// Velocities [data units] at x, NaN on land and outside.
template <class T, int kDim>
void sample_grid(const Grid<T, kDim>& grid, const Slice<T>& slice, const T* x, T* u,
                 std::int64_t count, int threads);

}  // namespace substep::fields
