"""Time integration and physics simulation for Python with a C++ core."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

# Public names by module. Each module is imported when one of its names is first used, so that
# `import substep` costs milliseconds.
_EXPORTS = {
    "config": ("num_threads", "set_num_threads", "show_config", "state_hash"),
    "errors": (
        "ConvergenceError",
        "CorruptError",
        "FormatError",
        "InputError",
        "NonFiniteError",
        "SingularMatrixError",
        "SolverError",
        "SubstepError",
        "TruncatedError",
        "VersionError",
    ),
    "export": ("pack",),
    "ode": (
        "EnsembleResult",
        "OdeResult",
        "OdeSolution",
        "SecondOrderResult",
        "solve_ensemble",
        "solve_ivp",
        "solve_second_order",
    ),
    "recording": ("Part", "Recorder", "Recording"),
    "fields": (
        "ABC",
        "Advection",
        "AdvectionResult",
        "DoubleGyre",
        "GridField",
        "RigidRotation",
        "Shear",
        "TaylorGreen",
        "advect",
        "open_field",
    ),
    "geometry": ("Box", "Plane", "SignedDistanceField", "Sphere", "liquid_surface"),
    "mpm": ("MaterialPointMethod",),
    "pbd": ("Distance", "PositionBasedDynamics"),
    "pbf": ("Emitter", "PositionBasedFluid", "Sink", "fill_box", "fill_mesh", "relax"),
    "rigid": ("RigidBatch", "RigidBodies"),
    "springs": ("MassSpring", "SoftBody"),
    "ode.scipy_solvers": (
        "DOP853",
        "RK4",
        "RK45",
        "Euler",
        "Heun",
        "ImplicitEuler",
        "Midpoint",
        "Radau",
    ),
}
_MODULE_OF = {name: module for module, names in _EXPORTS.items() for name in names}
_SUBMODULES = (
    "cli",
    "config",
    "ensemble",
    "errors",
    "export",
    "fields",
    "geometry",
    "linalg",
    "mpm",
    "ode",
    "pbd",
    "pbf",
    "recording",
    "render",
    "rigid",
    "scenes",
    "second_order",
    "springs",
    "stability",
    "systems",
)

__all__ = sorted([*_MODULE_OF, *_SUBMODULES])

if TYPE_CHECKING:
    __version__: str

    from . import _core as _core
    from .config import num_threads, set_num_threads, show_config, state_hash
    from .errors import (
        ConvergenceError,
        CorruptError,
        FormatError,
        InputError,
        NonFiniteError,
        SingularMatrixError,
        SolverError,
        SubstepError,
        TruncatedError,
        VersionError,
    )
    from .export import pack
    from .fields import (
        ABC,
        Advection,
        AdvectionResult,
        DoubleGyre,
        GridField,
        RigidRotation,
        Shear,
        TaylorGreen,
        advect,
        open_field,
    )
    from .geometry import Box, Plane, SignedDistanceField, Sphere, liquid_surface
    from .mpm import MaterialPointMethod
    from .ode import (
        EnsembleResult,
        OdeResult,
        OdeSolution,
        SecondOrderResult,
        solve_ensemble,
        solve_ivp,
        solve_second_order,
    )
    from .ode.scipy_solvers import (
        DOP853,
        RK4,
        RK45,
        Euler,
        Heun,
        ImplicitEuler,
        Midpoint,
        Radau,
    )
    from .pbd import Distance, PositionBasedDynamics
    from .pbf import Emitter, PositionBasedFluid, Sink, fill_box, fill_mesh, relax
    from .recording import Part, Recorder, Recording
    from .rigid import RigidBatch, RigidBodies
    from .springs import MassSpring, SoftBody


def __getattr__(name: str) -> Any:
    if name == "_core":
        from .base.native import load

        value: Any = load()
    elif name == "__version__":  # pyproject.toml has it, and the build gives it to the core
        value = __getattr__("_core").version
    elif name in _MODULE_OF:
        value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    elif name in _SUBMODULES:
        value = importlib.import_module(f".{name}", __name__)
    else:
        raise AttributeError(f"module 'substep' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
