"""The harmonic oscillator by every method with the same step: who keeps the energy?"""

import numpy as np
import substep

h, turns = 0.1, 100
end = turns * 2 * np.pi

print(f"x'' = -x, step {h}, {turns} revolutions\n{'method':<18}{'energy / initial energy'}")
for method in ("euler", "midpoint", "heun", "rk4", "RK45", "DOP853"):
    solution = substep.solve_ivp(
        lambda t, y: np.array([y[1], -y[0]]), (0, end), [1.0, 0.0], method, step=h
    )
    print(f"{method:<18}{np.sum(solution.y[:, -1] ** 2):.12g}")
for method in substep.stability.second_order_methods():
    solution = substep.solve_second_order(
        lambda t, x, v: -x, (0, end), [1.0], [0.0], method, step=h
    )
    print(f"{method:<18}{solution.x[0, -1] ** 2 + solution.v[0, -1] ** 2:.12g}")
