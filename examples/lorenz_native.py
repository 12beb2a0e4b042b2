"""The Lorenz attractor with right-hand sides in Python, compiled by Numba, and built in."""

import time

import numpy as np
import substep

sigma, rho, beta = 10.0, 28.0, 8.0 / 3.0


def lorenz(t, y):
    """The right-hand side as SciPy takes it."""
    return np.array([sigma * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - beta * y[2]])


right_hand_sides = {"Python": lorenz, "built in": substep.systems.Lorenz(sigma, rho, beta)}
try:
    import numba

    pointer = numba.types.CPointer(numba.float64)

    @numba.cfunc(numba.void(numba.float64, pointer, pointer, pointer))
    def compiled(t, y, dydt, p):
        """The same as a C function: void f(double t, double* y, double* dydt, double* p)."""
        dydt[0] = sigma * (y[1] - y[0])
        dydt[1] = y[0] * (rho - y[2]) - y[1]
        dydt[2] = y[0] * y[1] - beta * y[2]

    right_hand_sides["numba.cfunc"] = compiled
except ImportError:
    print("Numba is not installed: without the compiled function")

for name, fun in right_hand_sides.items():
    began = time.perf_counter()
    s = substep.solve_ivp(fun, (0, 10), [1.0, 1.0, 1.0], "DOP853", rtol=1e-10, atol=1e-10)
    milliseconds = 1e3 * (time.perf_counter() - began)
    print(f"{name:<12}{milliseconds:8.2f} ms  {s.nfev} evaluations  y(10) = {s.y[:, -1]}")
