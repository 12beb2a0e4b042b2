// The kinds of NewtonMatrices, each in a file of its own.
#pragma once

#include <memory>

#include "substep/ode/implicit/newton_matrices.h"

namespace substep::ode {

std::unique_ptr<NewtonMatrices> make_dense_matrices(System& system,
                                                    std::shared_ptr<Jacobian> jacobian,
                                                    std::shared_ptr<const MassMatrix> mass);
std::unique_ptr<NewtonMatrices> make_sparse_matrices(System& system,
                                                     std::shared_ptr<Jacobian> jacobian,
                                                     std::shared_ptr<const MassMatrix> mass);
std::unique_ptr<NewtonMatrices> make_krylov_matrices(System& system,
                                                     std::shared_ptr<Jacobian> jacobian,
                                                     const StepOptions& options);
// Krylov's until that is slower than factors, whose pattern tells what they cost.
std::unique_ptr<NewtonMatrices> make_automatic_matrices(System& system,
                                                        std::shared_ptr<Jacobian> jacobian,
                                                        const StepOptions& options);

// Throws NonFiniteError with the row of the first entry of J that is NaN or infinite.
void check_jacobian(double t, std::int64_t n, const SparsePattern* pattern,
                    const std::vector<double>& values);

// The pattern of n full columns.
SparsePattern full_pattern(std::int64_t n);

}  // namespace substep::ode
