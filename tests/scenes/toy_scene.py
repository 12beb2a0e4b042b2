"""A scene in a file of its own: random walkers, in Python alone, with a history that matters."""

import json
import time
from pathlib import Path

import numpy as np
from substep import NonFiniteError
from substep.scenes import Parameter, Scene


class Walkers:
    """Each step depends on the generator's state, so that only a whole checkpoint can go on."""

    def __init__(self, count, pause, fail_at, seed):
        self._random = np.random.default_rng(seed)
        self._points = self._random.normal(size=(count, 2))
        self._pause = pause
        self._fail_at = fail_at
        self._steps = 0

    @property
    def time(self):
        return self._steps * 0.5

    def advance(self, duration):
        for _ in range(round(duration / 0.5)):
            if self.time >= self._fail_at:
                raise NonFiniteError(
                    "walker 3: fell over; take shorter steps", time=self.time, index=3
                )
            time.sleep(self._pause)
            self._points = self._points + 0.1 * self._random.normal(size=self._points.shape)
            self._steps += 1

    def fields(self):
        return {"position": (self._points, "m"), "distance": (np.hypot(*self._points.T), "m")}

    def state(self):
        return self._steps, self._points.copy(), self._random.bit_generator.state

    def restore(self, state):
        self._steps, self._points = state[0], state[1].copy()
        self._random.bit_generator.state = state[2]

    def save(self, path):
        steps, points, generator = self.state()
        Path(path).write_text(json.dumps([steps, points.tolist(), generator]))

    def load(self, path):
        steps, points, generator = json.loads(Path(path).read_text())
        self.restore((steps, np.array(points), generator))


SCENE = Scene(
    name="walkers",
    doc="Random walkers.",
    parameters={
        "duration": Parameter("time simulated", 10.0, unit="s", above=0),
        "count": Parameter("number of walkers", 5, minimum=0),
        "pause": Parameter("wait in every step", 0.0, unit="s", minimum=0),
        "fail_at": Parameter("time at which a walker falls", 1e9, unit="s"),
    },
    build=lambda p, seed: Walkers(p["count"], p["pause"], p["fail_at"], seed),
    frames=21,
)
