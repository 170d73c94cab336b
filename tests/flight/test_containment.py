from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.samples import BOX

from aerotube.compensation import DECOUPLED, LinearLaw, synthesise
from aerotube.dynamics import ErrorCoordinates
from aerotube.flight import REASONS, Dryden, Trace, containment, draw, extended_kalman_filter, simulate
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceBox, parameter_ranges

RANGES = np.array([[0.95, 1.05]])


def tubes(beats, initial=1.0, size=1.0, terminal=1.0):
    """Balls of given radii in every shape."""
    unit = np.tile(np.eye(4), (beats, 2, 1, 1))
    return SimpleNamespace(
        parts=DECOUPLED,
        initial_shape=unit, initial_rho=np.full((beats, 2), initial**2),
        metric=unit, size=np.full((beats, 2), size**2),
        terminal_shape=unit, terminal_rho=np.full((beats, 2), terminal**2),
    )  # fmt: skip


def trace(*errors, seen=None, wind=None):
    """One run whose first longitudinal and first lateral error take given values."""
    error = np.zeros((1, len(errors), 8))
    error[0, :, [0, 4]] = np.array(errors, float).T
    measured = error[:, :-1] if seen is None else error[:, :-1] + np.array(seen, float)
    return Trace(error, measured, None if wind is None else np.array(wind, float))


NOMINAL_MASS = np.ones((1, 1))


def test_beats_are_counted_by_hand():
    """Inside, out through the tube, outside at the start, and back in."""
    flown = trace((0.9, 0.0), (0.5, 0.0), (1.5, 0.2), (0.1, 0.0))
    found = containment(flown, NOMINAL_MASS, tubes(3, size=1.2, terminal=2.0), RANGES)
    assert found.flown.tolist() == [1, 1, 1]
    assert found.inside.tolist() == [1, 1, 0]
    assert found.outside[:, REASONS.index("error")].tolist() == [0, 0, 1]
    assert found.violated[..., 0].tolist() == [[0, 0], [1, 0], [0, 0]]
    assert not found.violated[..., 1].any()
    np.testing.assert_allclose(found.worst[:2, 0, 0], [0.25 / 1.44, 2.25 / 1.44])
    assert np.isnan(found.worst[2]).all()


def test_every_part_must_start_inside():
    found = containment(trace((0.0, 1.1), (5.0, 5.0)), NOMINAL_MASS, tubes(1), RANGES)
    assert found.inside.tolist() == [0]
    assert not found.violated.any()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"seen": [[[0.0, 0.2, 0, 0, 0, 0, 0, 0]]]}, "measurement"),
        ({"wind": [[[0.0, 0.0, 2.0, 0, 0, 0]]]}, "wind"),
    ],
)
def test_measurement_errors_and_wind_have_sets_of_their_own(change, reason):
    flown = trace((0.0, 0.0), (3.0, 0.0), **change)
    without = containment(flown, NOMINAL_MASS, tubes(1), RANGES)
    assert without.inside.tolist() == [0]
    assert without.outside[0].tolist() == [int(name == reason) for name in REASONS]
    widths = {"measurement": np.full(8, 0.2)} if reason == "measurement" else {"wind": np.full((1, 6), 2.0)}
    held = containment(flown, NOMINAL_MASS, tubes(1), RANGES, **widths)
    assert held.inside.tolist() == [1]
    assert held.violated[0, 0].tolist() == [1, 1]


def test_parameters_outside_their_ranges_promise_nothing():
    found = containment(trace((0.0, 0.0), (3.0, 0.0)), np.array([[1.06]]), tubes(1), RANGES)
    assert found.inside.tolist() == [0]
    assert found.outside[0, REASONS.index("parameters")] == 1


def test_a_run_that_diverges_leaves_the_tube_and_is_no_longer_flown():
    error = np.zeros((1, 4, 8))
    error[0, 2:] = np.nan
    flown = Trace(error, error[:, :-1], None)
    found = containment(flown, NOMINAL_MASS, tubes(3), RANGES)
    assert found.flown.tolist() == [1, 1, 0]
    assert found.violated[:, 0, 0].tolist() == [0, 1, 0]


def test_where_there_is_no_tube_nothing_is_violated():
    own = tubes(1)
    own.size[0, 0] = np.nan
    found = containment(trace((0.0, 0.0), (9.0, 9.0)), NOMINAL_MASS, own, RANGES)
    assert found.violated[0].tolist() == [[0, 1], [1, 1]]


def short(table2, beats):
    nominal = table2.nominal
    return Nominal(nominal.dt, nominal.states[: beats + 1], nominal.controls[:beats])


def test_the_trace_is_what_the_law_was_given(table2):
    class Spy:
        coordinates = ErrorCoordinates("relative")
        asked = ()

        def increment(self, beat, error):
            self.asked += (error,)
            return np.zeros((len(error), 4))

    nominal, draws = short(table2, 6), draw(table2.box, [5], 20, mass_error=0.05)
    options = {
        "noise": 0.5,
        "estimator": extended_kalman_filter(table2.aircraft, nominal, table2.box, 0.5, mass_error=0.05),
        "gusts": Dryden("moderate", 3000, 185, 9.144),
    }
    for chosen in ({}, {"noise": 0.5}, options):
        spy = Spy()
        plain = simulate(table2.aircraft, nominal, spy, draws, **chosen)
        flown = simulate(table2.aircraft, nominal, spy, draws, trace=True, **chosen)
        np.testing.assert_array_equal(flown.error, plain.error)
        assert plain.trace is None
        np.testing.assert_array_equal(flown.trace.seen, np.stack(spy.asked[:6], axis=1))
        assert (flown.trace.wind is None) == ("gusts" not in chosen)
        # airspeed, flow angles and rates do not depend on the chart of the attitude
        same = [0, 1, 2, 4, 5, 6]
        np.testing.assert_allclose(flown.trace.error[..., same], flown.error[..., same], atol=1e-12)
        np.testing.assert_allclose(flown.trace.error[..., 3], flown.error[..., 3], atol=2e-3)
    calm = simulate(table2.aircraft, nominal, Spy(), draws, trace=True).trace
    np.testing.assert_array_equal(calm.seen, calm.error[:, :-1])


def test_flights_from_inside_their_box_keep_to_tubes_and_not_to_smaller_ones(table2):
    nominal, box = short(table2, 4), DisturbanceBox(BOX.half_widths, {"mass": 0.05})
    made = synthesise(table2.aircraft, nominal, box)
    draws = draw(table2.box, [1], 200, mass_error=0.05)
    flown = simulate(table2.aircraft, nominal, made.law, draws, trace=True)
    ranges = parameter_ranges(table2.aircraft, box.relative)
    found = containment(flown.trace, draws.parameters, made.tubes, ranges)
    assert found.inside[0] == 200
    assert found.violated[..., 0].sum() == 0
    small = replace(made.tubes, size=0.1 * made.tubes.size)
    assert containment(flown.trace, draws.parameters, small, ranges).violated[0, :, 0].min() > 0


def test_diverged_runs_have_no_trace(table2):
    draws = draw(table2.box, [1], 5)
    wild = LinearLaw(np.full((60, 4, 8), 50.0), ErrorCoordinates())
    flown = simulate(table2.aircraft, table2.nominal, wild, draws, trace=True)
    assert flown.diverged
    for divergence in flown.diverged:
        assert np.isnan(flown.trace.error[divergence.run, divergence.beat + 1 :]).all()
        assert np.isfinite(flown.trace.error[divergence.run, : divergence.beat + 1]).all()
