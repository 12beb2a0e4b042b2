// df/dy and M as Python gives them.
#pragma once

#include "bindings.h"
#include "substep/ode/implicit/jacobian.h"

// The option `jacobian` or `mass` of an integration, for bind_ode.
void bind_jacobians(py::module_& m);
