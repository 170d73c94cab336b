"""The compiled step against the NumPy equations it is compiled from."""

import numpy as np
import pytest

from aerotube.aircraft import F16, state_derivatives
from aerotube.dynamics.components import join, split
from aerotube.dynamics.step import step as step_map
from aerotube.dynamics.step import step_components
from tests.aircraft.samples import states

OPTIONS = [{}, {"interpolation": "smooth", "engine_momentum": 0.0}, {"engine_lag": True, "xcg": 0.33}]


def reference(aircraft, state, control, parameters, wind, dt, substeps):
    def rates(x):
        return state_derivatives(aircraft, x, control, parameters, wind)

    h = dt / substeps
    for _ in range(substeps):
        first = rates(state)
        second = rates(state + 0.5 * h * first)
        third = rates(state + 0.5 * h * second)
        state = state + h / 6.0 * (first + 2.0 * second + 2.0 * third + rates(state + h * third))
    state = state.copy()
    state[:, 3:7] /= np.linalg.norm(state[:, 3:7], axis=1, keepdims=True)
    return state


@pytest.mark.parametrize("options", OPTIONS, ids=["linear", "smooth", "lag"])
def test_compiled_step_is_the_numpy_step(options):
    aircraft, (state, control) = F16(**options), states(40, seed=60)
    random = np.random.default_rng(61)
    if aircraft.engine_lag:
        state = np.column_stack([state, random.uniform(0.0, 100.0, 40)])
    parameters = random.uniform(0.95, 1.05, (40, 1))
    wind = random.uniform(-5.0, 5.0, (40, 6)) * [1, 1, 1, 0.01, 0.01, 0.01]
    step = aircraft.compiled_step()
    for dt, substeps in ((0.05, 1), (0.05, 5), (0.001, 1)):
        found = step(state, control, parameters, wind, dt, substeps)
        expected = reference(aircraft, state, control, parameters, wind, dt, substeps)
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
    alone = step(state[7:8], control[7:8], parameters[7:8], wind[7:8], 0.05, 1)
    assert np.array_equal(alone[0], step(state, control, parameters, wind, 0.05, 1)[7])


def test_options_of_one_program_do_not_mix():
    """Aircraft share compiled code, not numbers."""
    state, control = states(3, seed=62)
    rest = (np.ones((3, 1)), np.zeros((3, 6)), 0.02, 1)
    first, second = F16(xcg=0.30), F16(xcg=0.35)
    steps = first.compiled_step(), second.compiled_step()
    for aircraft, step in zip((first, second), steps, strict=True):
        expected = reference(aircraft, state, control, *rest)
        assert step(state, control, *rest) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert np.abs(steps[0](state, control, *rest) - steps[1](state, control, *rest)).max() > 1e-6


def test_wrong_shapes_are_refused():
    state, control = states(3, seed=63)
    step = F16().compiled_step()
    with pytest.raises(ValueError, match=r"3 rows and \(13, 4, 1, 6\) columns"):
        step(state, control[:2], np.ones((3, 1)), np.zeros((3, 6)), 0.05, 1)
    with pytest.raises(ValueError, match="0 substeps"):
        step(state, control, np.ones((3, 1)), np.zeros((3, 6)), 0.05, 0)


@pytest.mark.parametrize("options", OPTIONS, ids=["linear", "smooth", "lag"])
def test_compiled_realise_is_realise(options):
    aircraft, (state, control) = F16(**options), states(40, seed=63)
    random = np.random.default_rng(64)
    increment = random.uniform(-1.0, 1.0, (40, 4)) * [0.1, 5e4, 0.1, 0.1]
    full = np.column_stack([state, np.zeros(40)]) if aircraft.engine_lag else state
    expected = aircraft.realise(full, control, increment)
    realise = aircraft.compiled_realise()
    found = realise(full, control, increment)
    assert np.array_equal(realise(full[3:4], control[3:4], increment[3:4])[0], found[3])
    assert np.clip(found, aircraft.control_lower, aircraft.control_upper) == pytest.approx(
        expected, rel=1e-12, abs=1e-12
    )


def test_other_equations_are_not_flown_by_compiled_ones():
    class Heavier(F16):
        def rates(self, state, control, parameters=None, wind=None):
            return super().rates(state, control, [0.9], wind)

        def realise(self, state, control, increment):
            return super().realise(state, control, 0.5 * np.asarray(increment))

    assert Heavier().compiled_step() is None
    assert Heavier().compiled_realise() is None
    assert F16().compiled_step() is not None


@pytest.mark.parametrize("options", [{}, {"interpolation": "smooth"}, {"uncertain": ("mass", "lift")}])
def test_compiled_step_with_increments_is_the_numpy_step(options):
    aircraft, (state, control) = F16(**options), states(40, seed=65)
    random = np.random.default_rng(66)
    increment = random.uniform(-1.0, 1.0, (40, 4)) * [0.1, 2e4, 0.1, 0.1]
    parameters = random.uniform(0.95, 1.05, (40, len(aircraft.parameter_names)))
    wind = random.uniform(-5.0, 5.0, (40, 6)) * [1, 1, 1, 0.01, 0.01, 0.01]
    found = aircraft.compiled_virtual_step()(state, control, increment, parameters, wind, 0.05, 2)
    expected = join(
        step_components(
            aircraft, split(state), split(control), 0.05, split(parameters), split(wind), split(increment), substeps=2
        )
    )
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert np.array_equal(found, step_map(aircraft, state, control, 0.05, parameters, wind, increment, substeps=2))
    for_all = aircraft.compiled_virtual_step()(state, control, increment[:1], parameters, wind, 0.05, 2)
    one_by_one = aircraft.compiled_virtual_step()(
        state, control, np.repeat(increment[:1], 40, axis=0), parameters, wind, 0.05, 2
    )
    assert np.array_equal(for_all, one_by_one)
    with pytest.raises(ValueError, match=r"increments of shape \(7, 4\)"):
        aircraft.compiled_virtual_step()(state, control, increment[:7], parameters, wind, 0.05, 2)


def test_there_is_no_compiled_step_with_increments_of_other_equations():
    class Sluggish(F16):
        def rates_virtual(self, state, control, increment, parameters=None, wind=None):
            return super().rates_virtual(state, control, [0.5 * part for part in increment], parameters, wind)

    assert Sluggish().compiled_virtual_step() is None
    assert Sluggish().compiled_step() is not None
    assert F16(engine_lag=True).compiled_virtual_step() is None
