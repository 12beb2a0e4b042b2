"""Tampered states: a short attack, with all that was found before."""

import contextlib

import numpy as np
import pytest
import states
import substep

SEED = 0
MORE = 60 if states.SANITIZED else 200  # than what was found before


def test_tampered_states_are_refused_or_harmless():
    told = states.attack(len(states.PAST) + MORE, SEED)
    assert told.pop("findings") == []
    assert set(told) == set(states.MAKERS)
    sums = {word: sum(row.get(word, 0) for row in told.values()) for word in ("calls", "refused")}
    assert sums["calls"] == len(states.PAST) + MORE
    assert 0.4 < sums["refused"] / sums["calls"] < 0.8


def test_the_attack_sees_crashes_and_wrong_errors():
    told = states.attack(len(states.PAST) + 2, SEED, only="crash")
    assert told["crash"] == {"calls": 2, "crashes": 2}
    assert len(told["findings"]) == 2
    target = states.Target("toy", states.advection_flow)
    good = target.good
    assert target.attack(good) == ("accepted", None)
    object.__setattr__(target.simulation, "_checked", dict)  # it trusts what it is given
    assert "KeyError of restore" in target.attack({})[1]
    toy = {"_checked": lambda state: state | {"stop_time": state["stop_time"] + 1}}  # it forgets
    vars(target.simulation).update(toy)
    with pytest.raises(AssertionError):  # its own state is not its own either
        target.attack(good)


def pin_all(simulation):
    simulation.pinned = np.ones(len(simulation), bool)


def empty(simulation):
    simulation.remove(simulation.ids)


def throw_far(simulation):
    """As far and as fast as it may be."""
    for far in (1e6, 1e9, 1e12, 1e38, 1e150):
        with contextlib.suppress(substep.InputError):
            simulation.set_positions(np.full(simulation.positions.shape, far))
    fast = 3e38 if getattr(simulation, "dtype", None) == np.float32 else 1e150
    with contextlib.suppress(substep.InputError, AttributeError):
        simulation.set_velocities(np.full_like(simulation.velocities, fast))


@pytest.mark.parametrize("name", states.MAKERS)
def test_what_state_gives_is_restored(name):
    for change, needed in ((pin_all, "pinned"), (empty, "remove"), (throw_far, "set_positions")):
        target = states.Target(name, states.MAKERS[name])
        if hasattr(target.simulation, needed):
            change(target.simulation)
            assert target._round_trip() is None, change.__name__
