from dataclasses import dataclass, replace

import numpy as np
import pytest

from aerotube.aircraft import F16
from aerotube.dynamics import ErrorCoordinates, euler_error, step
from aerotube.errors import InputError
from aerotube.flight import Dryden, draw, error_metric, extended_kalman_filter, simulate
from aerotube.nominal import Nominal, constant_controls

SPAN = 9.144


@dataclass
class Gain:
    """A linear law, row by row: its numbers do not depend on the batch."""

    gains: np.ndarray
    coordinates = ErrorCoordinates("relative")

    def increment(self, beat, error):
        return np.einsum("ij,...j->...i", self.gains, error)


def damper(scale=1.0):
    gains = np.zeros((4, 8))
    gains[0, [1, 2]] = 0.3, 0.3  # elevator against attack and pitch rate
    gains[1, 0] = -3000.0  # thrust against airspeed
    gains[2, 5] = 0.1  # aileron against roll rate
    gains[3, 6] = 0.2  # rudder against yaw rate
    return Gain(scale * gains)


def short(table2, beats=10):
    nominal = table2.nominal
    return Nominal(nominal.dt, nominal.states[: beats + 1], nominal.controls[:beats])


def test_without_disturbances_nothing_leaves_the_nominal(table2):
    draws = draw(np.zeros(8), [0, 1], 2)
    estimator = extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 0.0)
    for law in (None, damper()):
        flights = simulate(table2.aircraft, table2.nominal, law, draws, noise=1.0, estimator=estimator)
        np.testing.assert_allclose(flights.error, 0.0, atol=1e-9)
        np.testing.assert_allclose(flights.control, np.tile(table2.control, (4, 60, 1)), atol=1e-9)
        assert flights.mean_upper_error().shape == (2,)


def test_uncompensated_error_is_the_published_one(table2):
    nominal = constant_controls(table2.aircraft, table2.state, table2.control, 0.05, 100)
    flights = simulate(table2.aircraft, nominal, None, draw(table2.box, range(30), 100, mass_error=0.05))
    assert not flights.diverged
    envelope = flights.upper_envelope()
    np.testing.assert_array_equal(flights.mean_upper_error(), envelope.mean(axis=1))
    means = {seconds: envelope[:, : 20 * seconds + 1].mean(axis=1) for seconds in (1, 2, 3, 5)}
    # Two independent means over 30 seeds, each seed spread by 0.06: within four standard errors of each other.
    assert means[3].mean() == pytest.approx(1.23, abs=4 * 0.06 * np.sqrt(2 / 30))
    assert means[3].std(ddof=1) == pytest.approx(0.06, rel=0.4)
    for seconds, published in ((1, 1.47), (2, 1.27), (5, 1.68)):
        assert means[seconds].mean() == pytest.approx(published, rel=0.04)


def test_a_flight_is_the_beat_by_beat_recipe(table2):
    nominal, aircraft = short(table2), table2.aircraft
    draws = draw(table2.box, [4], 3, mass_error=0.05)
    law, euler = damper(), ErrorCoordinates("euler")
    flights = simulate(aircraft, nominal, law, draws, noise=0.5)
    noise = 0.5 * draws.measurement_noise(10)
    for run in range(3):
        state = euler.retract(nominal.states[0], draws.initial_error[run])
        for beat in range(10):
            np.testing.assert_allclose(
                flights.error[run, beat], euler_error(state, nominal.states[beat]), rtol=1e-9, atol=1e-11
            )
            seen = euler.retract(state, noise[run, beat])
            increment = law.increment(beat, law.coordinates.difference(seen, nominal.states[beat]))
            control = aircraft.realise(seen, nominal.controls[beat], increment)
            np.testing.assert_allclose(flights.control[run, beat], control, rtol=1e-9, atol=1e-11)
            state = step(aircraft, state, control, 0.05, parameters=draws.parameters[run])
    np.testing.assert_array_equal(flights.metric, error_metric(flights.error))
    np.testing.assert_allclose(flights.error[:, 0], draws.initial_error, atol=1e-12)


def test_the_law_sees_the_error_with_noise(table2):
    class Spy:
        coordinates = ErrorCoordinates("euler")
        seen = ()

        def increment(self, beat, error):
            self.seen += (error,)
            return np.zeros((len(error), 4))

    nominal, spy = short(table2), Spy()
    draws = draw(table2.box, [5], 50)
    flights = simulate(table2.aircraft, nominal, spy, draws, noise=0.5)
    seen = np.stack(spy.seen, axis=1)
    np.testing.assert_allclose(seen - flights.error[:, :-1], 0.5 * draws.measurement_noise(10), atol=1e-11)


def test_a_run_flies_the_same_in_any_batch(table2):
    nominal = short(table2, 20)
    options = {
        "noise": 1.0,
        "estimator": extended_kalman_filter(table2.aircraft, nominal, table2.box, 1.0, mass_error=0.05),
        "gusts": Dryden("moderate", 3000, 185, SPAN),
    }
    for law in (None, damper()):
        many = simulate(table2.aircraft, nominal, law, draw(table2.box, [1, 2, 3], 30, mass_error=0.05), **options)
        few = simulate(table2.aircraft, nominal, law, draw(table2.box, [2], 7, mass_error=0.05), **options)
        np.testing.assert_array_equal(many.error[30:37], few.error)
        np.testing.assert_array_equal(many.control[30:37], few.control)


@pytest.mark.parametrize("scale", [-300.0, 300.0])
def test_controls_stay_within_their_limits(table2, scale):
    aircraft = table2.aircraft
    draws = draw(table2.box, [0], 100, mass_error=0.05)
    flights = simulate(aircraft, short(table2, 20), damper(scale), draws, noise=1.0)
    assert np.all(flights.control >= aircraft.control_lower)
    assert np.all(flights.control <= aircraft.control_upper)
    low, high = flights.control_envelope()
    np.testing.assert_array_equal(low.min(0)[[0, 1]], aircraft.control_lower[[0, 1]])
    np.testing.assert_array_equal(high.max(0)[[0, 1]], aircraft.control_upper[[0, 1]])


def test_the_nominal_flies_alone_where_the_law_has_no_answer(table2):
    class Patchy(Gain):
        feasible = np.arange(10) % 3 != 1

        def increment(self, beat, error):
            assert self.feasible[beat]
            out = super().increment(beat, error)
            if beat == 3:
                out[5] = np.nan
            return out

    draws = draw(table2.box, [0], 20)
    flights = simulate(table2.aircraft, short(table2), Patchy(damper().gains), draws)
    expected = np.tile(~Patchy.feasible, (20, 1))
    expected[5, 3] = True
    np.testing.assert_array_equal(flights.fallback, expected)
    alone = np.all(flights.control == table2.control, axis=-1)
    np.testing.assert_array_equal(alone, expected)
    assert np.all(np.isfinite(flights.error))


def test_a_diverging_run_is_named_and_frozen_and_the_others_fly_on(table2):
    nominal = short(table2, 20)
    draws = draw(table2.box, [8, 9], 5, mass_error=0.05)
    errors = draws.initial_error.copy()
    errors[7, 2] = 6.0  # rad/s of pitch rate: the aircraft tumbles
    tumbling = replace(draws, initial_error=errors)
    estimator = extended_kalman_filter(table2.aircraft, nominal, table2.box, 1.0)
    for law in (None, damper()):
        flights = simulate(table2.aircraft, nominal, law, tumbling, noise=1.0, estimator=estimator)
        calm = simulate(table2.aircraft, nominal, law, draws, noise=1.0, estimator=estimator)
        (divergence,) = flights.diverged
        assert divergence.run == 7
        assert "run 2 of seed 9 diverged in beat" in str(divergence)
        assert "off the nominal" in str(divergence)
        frozen = flights.error[7, divergence.beat :]
        np.testing.assert_array_equal(frozen, np.tile(frozen[0], (len(frozen), 1)))
        assert np.all(np.isfinite(flights.metric))
        assert flights.outside[7]
        others = np.arange(10) != 7
        np.testing.assert_array_equal(flights.error[others], calm.error[others])


def test_a_state_that_is_no_number_is_named(table2):
    class Broken(F16):
        def rates(self, state, control, parameters=None, wind=None):
            rates = super().rates(state, control, parameters, wind)
            return (np.where(state[12] < 2990.0, np.nan, rates[0]), *rates[1:])

    flights = simulate(Broken(), short(table2), None, draw(table2.box, [0], 4))
    assert [divergence.run for divergence in sorted(flights.diverged, key=lambda d: d.run)] == [0, 1, 2, 3]
    assert all("no longer finite" in str(divergence) for divergence in flights.diverged)
    assert np.all(np.isfinite(flights.error))


def test_a_lagging_engine_at_rest_is_no_lag_at_all(table2):
    draws = draw(table2.box, [0], 10, mass_error=0.05)
    nominal = short(table2, 20)
    lagging = simulate(F16(xcg=0.30, engine_lag=True), nominal, None, draws)
    np.testing.assert_allclose(lagging.error, simulate(table2.aircraft, nominal, None, draws).error, atol=1e-9)
    with_law = simulate(F16(xcg=0.30, engine_lag=True), nominal, damper(), draws)
    without_lag = simulate(table2.aircraft, nominal, damper(), draws)
    assert not with_law.diverged
    assert np.abs(with_law.error - without_lag.error)[..., 0].max() > 1e-3


def test_finer_integration_changes_little(table2):
    draws = draw(table2.box, [0], 20, mass_error=0.05)
    fine = constant_controls(table2.aircraft, table2.state, table2.control, 0.05, 60)
    coarse = simulate(table2.aircraft, fine, None, draws)
    # The nominal was integrated in whole beats, so what changes is the error of its integration.
    finer = simulate(table2.aircraft, fine, None, draws, substeps=5)
    assert 0 < np.abs(coarse.metric - finer.metric).max() < 0.02


def test_gusts_are_felt_through_the_air(table2):
    draws = draw(np.zeros(8), [0], 200)
    nominal = short(table2, 20)
    light, severe = (
        simulate(table2.aircraft, nominal, None, draws, gusts=Dryden(severity, 3000, 185, SPAN))
        for severity in ("light", "severe")
    )
    assert not light.error[:, 0].round(12).any()
    ratio = np.sqrt((severe.metric**2).mean() / (light.metric**2).mean())
    # On the same draws the wind is in proportion to the intensity, and the answer nearly so.
    intensities = [Dryden(severity, 3000, 185, SPAN).intensity[0] for severity in ("light", "severe")]
    assert ratio == pytest.approx(intensities[1] / intensities[0], rel=0.15)


def test_envelopes(table2):
    flights = simulate(table2.aircraft, short(table2), damper(), draw(table2.box, [0, 1], 10))
    low, high = flights.error_envelope()
    assert np.all((low <= flights.error) & (flights.error <= high))
    assert np.any(low == flights.error, axis=0).all()
    assert np.any(high == flights.error, axis=0).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [({"noise": -0.1}, "noise"), ({"noise": np.inf}, "noise"), ({"substeps": 0}, "substeps")],
)
def test_mistakes_are_named(table2, options, words):
    with pytest.raises(InputError, match=words):
        simulate(table2.aircraft, table2.nominal, None, draw(table2.box, [0], 1), **options)


def test_an_estimator_for_a_shorter_flight_is_refused(table2):
    estimator = extended_kalman_filter(table2.aircraft, short(table2), table2.box, 1.0)
    with pytest.raises(InputError, match="shorter nominal"):
        simulate(table2.aircraft, table2.nominal, damper(), draw(table2.box, [0], 1), estimator=estimator)
