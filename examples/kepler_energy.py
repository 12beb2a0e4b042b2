"""A million steps round Kepler's ellipse: the symplectic methods keep the energy, RK4 loses it."""

import time

import numpy as np
import substep

h, steps = 0.01, 1_000_000
orbit = substep.systems.Kepler(eccentricity=0.6)


def report(method, y, began):
    """Largest relative energy error over the first hundredth and over all of the steps."""
    energy = orbit.energy(y)
    error = abs(energy / energy[0] - 1)
    seconds = time.perf_counter() - began
    print(f"{method:<18}{error[: steps // 100].max():<12.2e}{error.max():<12.2e}{seconds:.2f} s")


print(f"{'method':<18}{'1e4 steps':<12}{'1e6 steps':<12}time")
for method in substep.stability.second_order_methods():
    began = time.perf_counter()
    s = substep.solve_second_order(
        orbit, (0, steps * h), orbit.y0[:2], orbit.y0[2:], method, step=h
    )
    report(method, np.concatenate([s.x, s.v]), began)
began = time.perf_counter()
report("rk4", substep.solve_ivp(orbit, (0, steps * h), orbit.y0, "rk4", step=h).y, began)
