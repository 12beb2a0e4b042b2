"""A ball that bounces: every flight ends with an event, and the next begins with its velocity."""

import numpy as np
import substep

gravity, restitution = 9.81, 0.8


def flight(t, y):
    """Height and vertical velocity."""
    return np.array([y[1], -gravity])


def ground(t, y):
    """Falls through zero when the ball arrives."""
    return y[0]


ground.terminal, ground.direction = True, -1

t, y = 0.0, np.array([1.0, 0.0])
for bounce in range(8):
    solution = substep.solve_ivp(flight, (t, t + 10), y, events=ground, rtol=1e-10, atol=1e-12)
    t, speed = solution.t_events[0][0], -solution.y_events[0][0][1]
    print(f"bounce {bounce + 1}: t = {t:.9f} s, arrives at {speed:.9f} m/s")
    y = np.array([0.0, restitution * speed])

# The first fall takes sqrt(2 / g); each flight after it 0.8 times as long as the one before.
fall = np.sqrt(2 / gravity)
expected = fall + 2 * fall * sum(restitution**k for k in range(1, 8))
print(f"error of the last time: {abs(t - expected):.1e} s")
