import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from aerotube.errors import InputError
from aerotube.flight import (
    error_metric,
    mean_absolute_error,
    mean_upper_error,
    root_mean_square_error,
    upper_envelope,
)

ERRORS = arrays(float, (3, 8), elements=st.floats(-10, 10))


@given(ERRORS)
def test_metric_is_eq_18_written_out(error):
    for row, value in zip(error, error_metric(error), strict=True):
        terms = [row[0] / 10**2, *(np.rad2deg(x) for x in row[1:])]
        assert value == pytest.approx(np.sqrt(sum(x**2 for x in terms) / 8), rel=1e-12, abs=1e-300)


def test_metric_of_one_degree_and_of_a_hundred_metres_per_second():
    assert error_metric(np.deg2rad([0, 1, 0, 0, 0, 0, 0, 0])) == pytest.approx(np.sqrt(1 / 8), rel=1e-14)
    assert error_metric(np.array([100.0, 0, 0, 0, 0, 0, 0, 0])) == pytest.approx(np.sqrt(1 / 8), rel=1e-14)


@given(arrays(float, (6, 5), elements=st.floats(0, 1e3)))
def test_mean_upper_error_by_hand(metric):
    expected = [np.mean([max(metric[run, t] for run in runs) for t in range(5)]) for runs in ((0, 1, 2), (3, 4, 5))]
    np.testing.assert_allclose(mean_upper_error(metric, 2), expected, rtol=1e-12)
    assert upper_envelope(metric, 2).shape == (2, 5)


def test_uneven_seeds_are_refused():
    with pytest.raises(InputError, match="do not divide"):
        upper_envelope(np.zeros((5, 2)), 2)


@given(arrays(float, (4, 9), elements=st.floats(-1e3, 1e3)))
def test_rmse_squared_is_mae_squared_plus_variance(metric):
    mae, rmse = mean_absolute_error(metric), root_mean_square_error(metric)
    np.testing.assert_allclose(rmse**2, mae**2 + np.abs(metric).var(axis=-1), rtol=1e-9, atol=1e-9)
