"""The scene water-column against its experiment: Kleefsman et al., J. Comput. Phys. 206, 2005."""

import json
from pathlib import Path

import numpy as np
import pytest
import substep
from substep import scenes

REFERENCE = Path(__file__).parents[3] / "shared/reference/kleefsman.json"
HEIGHT = 0.55  # of the water at the start [m]


@pytest.fixture(scope="module")
def experiment():
    if not REFERENCE.exists():
        pytest.skip("the reference values of ../shared are not here")
    return json.loads(REFERENCE.read_text())


@pytest.fixture(scope="module")
def log(experiment):
    """Gauges, sensors and volume of a run on a coarse grid, after every step."""
    scene = scenes.load("water-column")
    tank = scene.build(scene.complete({"cells": 58}), 0)
    kept = substep.Logger(
        {
            "depths": lambda tank: tank.depths(),
            "pressures": lambda tank: tank.pressures(),
            "volume": lambda tank: tank.volume(),
        }
    )
    tank.advance(6.0, kept)  # in one go: the last steps of a call are shortened
    return kept


def held(log, name, times):
    """The values of the steps in which the times lie: a pressure acts for the whole step."""
    return log[name][np.minimum(np.searchsorted(log.times, times), len(log.times) - 1)]


@pytest.mark.slow
@pytest.mark.parametrize(("gauge", "column"), [("H2", 1), ("H4", 3)])
def test_depths_are_those_of_the_experiment(log, experiment, gauge, column):
    times = np.array(experiment["heights"]["t"])
    computed = np.interp(times, log.times, log["depths"][:, column])
    error = np.abs(computed - experiment["heights"][gauge])
    assert times[-1] == 6 and error.mean() < 0.06 * HEIGHT


@pytest.mark.slow
def test_the_front_comes_when_it_should(log, experiment):
    scalars = experiment["height_scalars"]["H2"]
    depths = log["depths"][:, 1]
    assert log.times[np.argmax(depths > 0.05)] == pytest.approx(scalars["t_above_0.05"], rel=0.05)
    rise = experiment["pressure_scalars"]["P1"]["t_rise_above_1000Pa"]
    step = np.argmax(log["pressures"][:, 0] > 1000)
    assert log.times[step - 1 : step + 1].mean() == pytest.approx(rise, rel=0.08)


@pytest.mark.slow
def test_the_impact_on_the_box(log, experiment):
    scalars = experiment["pressure_scalars"]["P1"]
    times = np.arange(0, 1, 1e-3)
    pressure = held(log, "pressures", times)[:, 0]
    for width, name in ((10, "peak_10ms_mean_Pa_t"), (20, "peak_20ms_mean_Pa_t")):
        mean = np.convolve(pressure, np.ones(width) / width, "same")
        peak, time = scalars[name]
        assert mean.max() == pytest.approx(peak, rel=0.2)
        assert times[mean.argmax()] == pytest.approx(time, rel=0.12)
    impulse = pressure[(times >= 0.4) & (times < 0.6)].sum() * 1e-3
    assert impulse == pytest.approx(scalars["impulse_Pa_s_0.4_0.6"], rel=0.2)


@pytest.mark.slow
def test_the_wave_comes_back_to_the_box(log, experiment):
    expected = experiment["pressure_scalars"]["P1"]["second_impact_t_rise"]
    times = np.arange(4.2, 6, 1e-3)
    mean = np.convolve(held(log, "pressures", times)[:, 0], np.ones(50) / 50, "valid")
    back = times[25 + np.argmax(mean > expected["threshold_Pa"])]
    assert back == pytest.approx(expected["t"], rel=0.05)


@pytest.mark.slow
def test_the_volume_stays(log):
    volume = log["volume"]
    assert volume[0] == pytest.approx(1.228 * 1.0 * HEIGHT, rel=0.02)
    assert volume[-50:].mean() == pytest.approx(volume[0], rel=0.015)
