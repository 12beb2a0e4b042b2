"""Tampered states: a short attack, with all that was found before."""

import pytest
import states

SEED = 17


def test_tampered_states_are_refused_or_harmless():
    told = states.attack(len(states.PAST) + 300, SEED)
    assert told.pop("findings") == []
    assert set(told) == set(states.MAKERS)
    sums = {word: sum(row.get(word, 0) for row in told.values()) for word in ("calls", "refused")}
    assert sums["calls"] == len(states.PAST) + 300
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
