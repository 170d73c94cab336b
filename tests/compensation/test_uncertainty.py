"""Parameters between their extremes."""

import numpy as np
import pytest

from aerotube.aircraft import F16
from aerotube.compensation import DECOUPLED, SynthesisSettings, certified_size, design
from aerotube.compensation.uncertainty import size_over_parameters
from aerotube.dynamics import ErrorCoordinates, error_map
from aerotube.errors import InputError
from aerotube.nominal import constant_controls
from aerotube.tube import DisturbanceBox, parameter_ranges
from tests.samples import BOX, HALF_WIDTHS, TABLE2_CONTROL, aircraft, table2, table2_state

BEATS = range(2)
SETTINGS = SynthesisSettings(certificate="polynomial only")


@pytest.mark.parametrize("given", [{"mass": 0.2}, {"mass": 0.1, "lift": 0.1}], ids=["mass", "mass and lift"])
def test_the_extremes_are_enough_where_the_rates_are_affine(given):
    plane, box = F16(uncertain=tuple(given)), DisturbanceBox(HALF_WIDTHS, given)
    nominal = constant_controls(plane, table2_state(), TABLE2_CONTROL, 0.05, 3)
    made = design(plane, nominal, box, SETTINGS, beats=BEATS)
    extremes = certified_size(plane, nominal, box, made.law, made.metric, SETTINGS, beats=BEATS)
    for index, part in enumerate(DECOUPLED):
        between = size_over_parameters(plane, nominal, box, made.law, made.metric[index], part, beats=BEATS)
        assert between == pytest.approx(extremes[:, index], rel=5e-3)


class Wavering(F16):
    """Its mass is nominal at the extremes of the parameter, and half of that in between."""

    def rates(self, state, control, parameters=None, wind=None):
        return super().rates(state, control, _bent(parameters), wind)

    def rates_virtual(self, state, control, increment, parameters=None, wind=None):
        return super().rates_virtual(state, control, increment, _bent(parameters), wind)


def _bent(parameters):
    return None if parameters is None else [1.0 - 9.0 * (parameters[0] - 1 / 1.3) * (parameters[0] - 1 / 0.7)]


def test_what_is_worst_in_between_is_found():
    plane, box, part = Wavering(), DisturbanceBox(HALF_WIDTHS, {"mass": 0.3}), DECOUPLED[0]
    nominal = table2(2)
    metric = np.repeat(np.diag([0.01, *[np.degrees(1.0)] * 3])[None] ** 2, 2, axis=0)
    settings = SynthesisSettings(certificate="polynomial only")
    extremes = certified_size(plane, nominal, box, None, [metric, metric], settings, beats=BEATS)[:, 0]
    between = size_over_parameters(plane, nominal, box, None, metric, part, beats=BEATS)
    rng = np.random.default_rng(40)
    z = rng.normal(size=(500, 4))
    error = np.zeros((2, 500, 8))
    error[..., :4] = 2.0 * HALF_WIDTHS[:4] * z / np.linalg.norm(z, axis=1, keepdims=True)
    low, high = parameter_ranges(plane, box.relative)[0]
    sigma = np.broadcast_to(rng.uniform(low, high, (500, 1)), (2, 500, 1))
    end = error_map(plane, nominal, BEATS, ErrorCoordinates(), error, parameters=sigma)[..., :4]
    found = np.einsum("bui,bij,buj->bu", end, metric, end).max(axis=1)
    assert (found <= between * (1 + 1e-3)).all()
    assert (found > 1.1 * extremes).all()
    assert (between < 1.3 * found).all()


def test_nothing_uncertain_is_said():
    with pytest.raises(InputError, match="no parameter is uncertain"):
        size_over_parameters(
            aircraft(), table2(), DisturbanceBox(BOX.half_widths), None, np.eye(4)[None], DECOUPLED[0], beats=range(1)
        )
