// RKC2: an explicit method of order 2 for stiff problems whose eigenvalues lie near the negative
// real axis, as those of diffusion do. A step of s stages is stable for h rho up to 0.65 (s^2 - 1),
// where rho is the spectral radius of df/dy, so its cost grows with the root of the stiffness.
#pragma once

#include <memory>
#include <string_view>

#include "substep/ode/stepping/stepper.h"

namespace substep::ode {

inline constexpr std::string_view kRkc2 = "RKC2";

std::unique_ptr<Stepper> make_rkc2(System& system, const StepOptions& options);

}  // namespace substep::ode
