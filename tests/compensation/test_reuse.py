"""Control reuse: one law serves several beats."""

import numpy as np
import pytest

from aerotube.compensation import DECOUPLED, SynthesisSettings, design
from aerotube.compensation.groundwork import groundwork
from aerotube.errors import InputError
from aerotube.tube import DisturbanceBox
from tests.samples import BOX, HALF_WIDTHS, aircraft, table2

BEATS = 7
TINY = DisturbanceBox(1e-4 * HALF_WIDTHS, {})


def made(**settings):
    return design(aircraft(), table2(BEATS), BOX, SynthesisSettings(**settings))


def test_the_beats_of_a_group_share_a_law_and_the_last_group_is_shorter():
    result = made(reuse=2)
    gains = result.law.gains
    assert result.feasible.all()
    for first, last in ((0, 2), (3, 5)):
        assert (gains[first : last + 1] == gains[first]).all()
    np.testing.assert_allclose(gains[6], made().law.gains[6])
    assert np.abs(gains[3] - gains[2]).max() > 0
    assert np.abs(gains[6] - gains[5]).max() > 0


def test_some_beats_have_the_laws_of_all():
    """Whichever are asked for: groups are counted from the nominal's start."""
    whole = made(reuse=2)
    some = design(aircraft(), table2(BEATS), BOX, SynthesisSettings(reuse=2), beats=range(4, 7))
    np.testing.assert_array_equal(some.law.gains[4:7], whole.law.gains[4:7])
    np.testing.assert_array_equal(some.bound, whole.bound[4:7])
    assert (some.law.gains[:4] == 0).all()


def test_for_small_errors_the_law_is_the_best_compromise_of_its_beats():
    """Second route: the sum of the beats' mean squares, a quadratic in the gains, in closed form."""
    settings = SynthesisSettings(reuse=1, noise_weight=1.0, control_weight=0.1)
    plane, nominal = aircraft(), table2(2)
    result = design(plane, nominal, TINY, settings)
    ground = groundwork(plane, nominal, TINY, settings)
    for index, part in enumerate(DECOUPLED):
        e, c = list(part.errors), list(part.controls)
        hessian, slope, constant = np.zeros((8, 8)), np.zeros(8), 0.0
        for t in range(2):
            expected = ground.expected
            P, M, V = expected.cost[t + 1], expected.moment[t], expected.noise[t][np.ix_(e, e)]
            B = np.zeros((len(P), 4))
            B[:8] = ground.linear.B[t]
            others = expected.gain[t].copy()
            others[c] = 0.0
            open_loop = expected.step[t].copy()
            open_loop[:, :8] += B @ others
            R = ground.effort[t][np.ix_(c, c)] + B[:, c].T @ P @ B[:, c]
            hessian += np.kron(R, M[np.ix_(e, e)] + V)
            slope += (B[:, c].T @ P @ open_loop @ M[:, e]).ravel()
            # what the own errors tell, and what an extreme of the parameters does besides
            told = M[:, e] @ np.linalg.solve(M[np.ix_(e, e)], M[e])
            constant += np.trace(P @ open_loop @ told @ open_loop.T)
            constant += (
                expected.step[t][:8, 8]
                @ P[:8, :8]
                @ expected.step[t][:8, 8]
                * np.trace(
                    np.linalg.inv(ground.parts[index].initial.whitening[t])
                    @ M[np.ix_(e, e)]
                    @ np.linalg.inv(ground.parts[index].initial.whitening[t]).T
                )
            )

        def cost(K, hessian=hessian, slope=slope, constant=constant):
            return constant + 2 * slope @ K.ravel() + K.ravel() @ hessian @ K.ravel()

        best = -np.linalg.solve(hessian, slope).reshape(2, 4)
        law = result.law.gains[0][np.ix_(c, e)]
        assert cost(best) * (1 - 1e-12) <= cost(law) <= cost(best) * (1 + 1e-5)
        np.testing.assert_allclose(result.bound[0, index], cost(law), rtol=1e-3)  # the map bends a little


def test_the_worst_case_of_a_shared_law_is_no_better_than_those_of_its_beats():
    settings = {"size": "worst-case", "control_weight": 1e-6}
    alone, shared = made(**settings), made(reuse=1, **settings)
    for first in (0, 2, 4):
        assert (shared.bound[first] >= alone.bound[first : first + 2].max(0) * (1 - 1e-6)).all()


def test_a_negative_reuse_is_named():
    with pytest.raises(InputError, match="reuse is -1"):
        SynthesisSettings(reuse=-1)
