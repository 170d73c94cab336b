"""The paper's increment form."""

import numpy as np

from aerotube.compensation import DECOUPLED, increment
from aerotube.dynamics import ErrorCoordinates, error_map
from tests.samples import HALF_WIDTHS, aircraft, table2

EULER = ErrorCoordinates("euler")


def test_increments_are_those_of_the_flown_step_to_third_order():
    plane, nominal, part = aircraft("smooth"), table2(2, "smooth"), DECOUPLED[0]
    ranges = np.tile(np.asarray(plane.parameter_nominal)[:, None], (1, 2))
    ranges[0] = 0.997, 1.003
    whitening = np.diag(0.05 * 2.0 * HALF_WIDTHS[list(part.errors)])[None]
    beats = np.array([1])
    made = increment.sampled(plane, nominal, beats, EULER, part, ranges, whitening)
    points = increment.structure(increment.Shape(4, 2, 1, 1)).nodes("tube")
    error = np.zeros((1, len(points), 8))
    error[..., part.errors] = points[:, :4] @ whitening[0]
    sigma = np.broadcast_to(np.asarray(plane.parameter_nominal), (1, len(points), len(ranges))).copy()
    sigma[..., 0] = 1.0 + 0.003 * points[:, 4]
    end = error_map(plane, nominal, beats, EULER, error, parameters=sigma)
    expected = np.linalg.solve(whitening, np.swapaxes((end - error)[..., part.errors], 1, 2))
    np.testing.assert_allclose(np.swapaxes(made, 1, 2), expected, atol=1e-4 * np.abs(expected).max())
