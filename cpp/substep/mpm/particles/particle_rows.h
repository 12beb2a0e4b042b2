// Rows of particles: copied, left out and moved.
#pragma once

#include <span>

#include "substep/geometry/vectors.h"
#include "substep/mpm/particles/particles.h"

namespace substep::mpm {

// Room for n rows of so many numbers of state.
template <class Real, int D>
void reserve(ParticleRows<Real, D>& rows, std::size_t n, std::size_t width);

// Adds row i of another.
template <class Real, int D>
void append(ParticleRows<Real, D>& rows, const ParticleRows<Real, D>& from, std::size_t i);

// Leaves those for which stays[i] is not 0, in their order.
template <class Real, int D>
void keep(ParticleRows<Real, D>& rows, std::span<const std::uint8_t> stays);

// World position [m] of row i; in 2D z = 0.
template <class Real, int D>
geometry::Vec3 position(const ParticleRows<Real, D>& rows, std::size_t i, double cell);
template <class Real, int D>
void set_position(ParticleRows<Real, D>& rows, std::size_t i, double cell, const geometry::Vec3& x);

// Gives those that have left their blocks new ones.
template <class Real, int D>
void place_again(ParticleRows<Real, D>& rows);

}  // namespace substep::mpm
