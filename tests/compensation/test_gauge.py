"""The tube as a gauge: of a condition alone, of many at once, and of a beat of a manoeuvre."""

from dataclasses import replace

import numpy as np
import pytest

from aerotube.compensation import SynthesisSettings, gauge, gauge_beat
from aerotube.dynamics import ErrorCoordinates, error_map
from aerotube.errors import InputError
from aerotube.tube import DisturbanceBox, DisturbanceEllipsoid
from tests.samples import BOX, HALF_WIDTHS, TABLE2_CONTROL, aircraft, table2, table2_state

LOCAL = SynthesisSettings(shape="riccati", certificate="polynomial only")
STATES = table2().states[[0, 2, 5]]


def same(one, other, tolerance=1e-5):
    assert one.size == pytest.approx(other.size, rel=tolerance)
    assert one.size_nominal == pytest.approx(other.size_nominal, rel=tolerance)
    for name in ("half_widths", "half_widths_nominal", "half_widths_initial"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=tolerance, nan_ok=True)
    scale = np.abs(other.gains).max(axis=-1, keepdims=True)
    assert one.gains / scale == pytest.approx(other.gains / scale, abs=1e-4)


def test_a_condition_is_a_manoeuvre_of_one_beat():
    """The synthesis of a nominal of one beat is another route to the same numbers."""
    same(gauge(aircraft(), table2_state(), TABLE2_CONTROL, BOX), gauge_beat(aircraft(), table2(1), 0, BOX, LOCAL))


def test_many_at_once_are_each_alone():
    many = gauge(aircraft(), STATES.reshape(1, 3, 13), TABLE2_CONTROL, BOX)
    assert many.size.shape == (1, 3, 2)
    assert many.half_widths.shape == (1, 3, 8)
    assert many.gains.shape == (1, 3, 4, 8)
    assert many.certificate.shape == many.feasible.shape == (1, 3, 2)
    assert many.feasible.all()
    for i, state in enumerate(STATES):
        alone = gauge(aircraft(), state, TABLE2_CONTROL, BOX)
        own = {name: getattr(many, name)[0, i] for name in vars(many) if name not in ("parts", "messages", "tubes")}
        same(alone, replace(alone, **own))
    quick = gauge(aircraft(), STATES, TABLE2_CONTROL, BOX, ellipsoids=False)
    assert quick.size == pytest.approx(many.size[0], rel=1e-3)
    assert np.isnan(quick.half_widths).all()
    assert (quick.ratio < 1).all()


def test_flown_errors_stay_inside():
    """Errors of each half, drawn from the box and flown with the law on the true map."""
    settings = replace(LOCAL, certificate="sampled")
    found, nominal = gauge(aircraft(), table2_state(), TABLE2_CONTROL, BOX, settings), table2(1)
    assert (found.certificate == "sampled").all()
    rng = np.random.default_rng(30)
    for index, own in enumerate(((0, 1, 2, 3), (4, 5, 6, 7))):
        shape, rho = found.tubes.initial_shape[0, index], found.tubes.initial_rho[0, index]
        z = rng.normal(size=(400, 4))
        z /= np.sqrt(np.einsum("ui,ij,uj->u", z, shape, z) / rho)[:, None]
        start = np.zeros((1, 400, 8))
        start[0][:, own] = z
        push = start @ found.gains.T
        sigma = np.broadcast_to(BOX.parameter_vertices(aircraft())[rng.integers(0, 2, 400)], (1, 400, 1))
        end = error_map(aircraft(), nominal, [0], ErrorCoordinates(), start, increment=push, parameters=sigma)[0][
            :, own
        ]
        metric = found.tubes.metric[0, index]
        assert (np.einsum("ui,ij,uj->u", end, metric, end) <= found.size[index]).all()
        assert (np.abs(end) <= found.half_widths[list(own)]).all()


def test_a_smaller_set_has_a_smaller_tube():
    box, half, ball = (
        gauge(aircraft(), table2_state(), TABLE2_CONTROL, given)
        for given in (
            BOX,
            DisturbanceBox(0.5 * HALF_WIDTHS, BOX.relative),
            DisturbanceEllipsoid(np.diag(HALF_WIDTHS**-2.0)),
        )
    )
    assert half.half_widths_initial == pytest.approx(0.5 * box.half_widths_initial, rel=0.02)
    assert (half.size_nominal < 0.5 * box.size_nominal).all()
    assert (ball.size_nominal < half.size_nominal * 1.2).all()
    assert (ball.half_widths_nominal < box.half_widths_nominal).all()


@pytest.mark.parametrize(
    ("state", "control", "settings", "words"),
    [
        (np.zeros(12), TABLE2_CONTROL, None, "last axes must be 13 and 4"),
        (table2_state(), [0.0, 2.0, 0.0, 0.0], None, "throttle is 2"),
        (table2_state() * [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 10], TABLE2_CONTROL, None, "altitude is 30000 m"),
        (table2_state(), TABLE2_CONTROL, SynthesisSettings(), "no beats that follow"),
    ],
)
def test_mistakes_are_named(state, control, settings, words):
    with pytest.raises(InputError, match=words):
        gauge(aircraft(), state, control, BOX, settings)


def test_a_beat_beyond_the_manoeuvre_is_refused():
    with pytest.raises(InputError, match="beats 0 to 9; 10 is none"):
        gauge_beat(aircraft(), table2(), 10, BOX)
