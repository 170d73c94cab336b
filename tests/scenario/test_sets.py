"""Disturbance sets other than boxes, named in a scenario."""

import itertools

import numpy as np
import pytest

from aerotube import inequality, scenario
from aerotube.errors import InputError
from aerotube.preparation import prepare
from aerotube.tube import DisturbanceEllipsoid, DisturbancePolytope, SemialgebraicSet

TEXT = scenario.built_in_text().replace("seeds = 30 ", "seeds = 2 ")
NAMES = scenario.ERRORS
WIDTHS = np.array(scenario.load().scenario.disturbance.half_widths)


def made(kind, lines=""):
    return prepare(scenario.parse(TEXT.replace('set = "box"', f'set = "{kind}"\n{lines}\n')))


def values(text, y):
    """What an inequality's polynomial is at errors in units of the half-widths, (..., 8)."""
    terms = inequality.parse(text, NAMES)
    return sum(value * np.prod(y ** np.array(powers), axis=-1) for powers, value in terms.items())


@pytest.mark.parametrize(
    ("text", "by_hand"),
    [
        ("V + 2 alpha^2 <= 1.5", lambda V, a, q, t: 1.5 - V - 2 * a**2),
        ("1.5 >= V + 2 alpha^2", lambda V, a, q, t: 1.5 - V - 2 * a**2),
        ("(V - alpha)*(V + alpha) >= -q*theta/4", lambda V, a, q, t: V**2 - a**2 + q * t / 4),
        ("-(V - 2)**2 + 4 - 0.5 q >= 1e-1 theta", lambda V, a, q, t: -((V - 2) ** 2) + 4 - 0.5 * q - 0.1 * t),
        ("2 (V + alpha) <= 3 V^3", lambda V, a, q, t: 3 * V**3 - 2 * (V + a)),
    ],
)
def test_inequalities_are_read_as_they_are_written(text, by_hand):
    y = np.random.default_rng(0).uniform(-1, 1, (50, 8))
    np.testing.assert_allclose(values(text, y), by_hand(*y.T[:4]), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("V + alpha", "no inequality"),
        ("V <= 1 <= alpha", "no inequality"),
        ("V + <= 1", "cannot be read"),
        ("V^0.5 <= 1", "cannot be read"),
        ("1/V <= 1", "cannot be read"),
        ("__import__('os') <= 1", "cannot be read"),
        ("V^99 <= 1", "cannot be read"),
        ("True*V <= 1", "cannot be read"),
        ("altitude <= 1", "unknown name altitude"),
        ("1 <= 2", "does not depend"),
        ("V - V <= 2", "does not depend"),
        ("1e999 V <= 1", "too large"),
    ],
)
def test_what_is_no_inequality_is_told_in_one_sentence(text, said):
    with pytest.raises(ValueError, match=said) as caught:
        inequality.parse(text, NAMES)
    assert "\n" not in str(caught.value)


def test_an_ellipsoid_has_the_half_widths_as_its_half_axes():
    ready = made("ellipsoid")
    assert isinstance(ready.disturbance, DisturbanceEllipsoid)
    np.testing.assert_allclose(ready.disturbance.half_widths, WIDTHS)
    y = ready.draws.initial_error / WIDTHS
    size = np.linalg.norm(y, axis=1)
    assert (size <= 1 + 1e-12).all()
    assert size.max() > 0.95
    noise = ready.draws.measurement_noise(20) / WIDTHS
    assert np.abs(noise).max() <= 1.0
    assert np.linalg.norm(noise, axis=-1).max() > 1.5  # sensors keep to their box


def test_an_ellipsoid_may_be_inclined():
    M = np.eye(8)
    M[0, 1] = M[1, 0] = 0.8
    ready = made("ellipsoid", f"matrix = {M.tolist()}")
    y = ready.draws.initial_error / WIDTHS
    assert (np.einsum("ri,ij,rj->r", y, M, y) <= 1 + 1e-12).all()
    np.testing.assert_allclose(ready.disturbance.half_widths[0], WIDTHS[0] / 0.6)  # 1 / sqrt(1 - 0.8^2)


@pytest.mark.parametrize(
    ("kind", "which", "texts"),
    [
        ("polytope", DisturbancePolytope, ["V + alpha <= 1.2", "V - alpha >= -1.2"]),
        ("semialgebraic", SemialgebraicSet, ["V^2 + alpha^2 <= 1"]),
    ],
)
def test_cut_boxes_hold_what_they_say_and_are_flown(kind, which, texts):
    ready = made(kind, f"inequalities = {texts}")
    assert isinstance(ready.disturbance, which)
    drawn = ready.draws.initial_error
    assert ready.disturbance.contains(drawn).all()
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=8)))
    inside = np.all([values(text, corners) >= 0 for text in texts], axis=0)
    np.testing.assert_array_equal(ready.disturbance.contains(0.999 * corners * WIDTHS), inside)
    assert inside.any() == (kind == "polytope")
    y = drawn / WIDTHS
    assert all((values(text, y) >= -1e-9).all() for text in texts)
    assert np.abs(y).max() <= 1 + 1e-9


@pytest.mark.parametrize(
    ("kind", "lines", "said"),
    [
        ("polytope", "", "needs disturbance.inequalities"),
        ("box", 'inequalities = ["V <= 1"]', "belong to set"),
        ("polytope", 'inequalities = ["V^2 <= 1"]', r'"V\^2 <= 1" of the polytope is not linear'),
        ("polytope", 'inequalities = ["V >= 0.5"]', r'"V >= 0.5".*undisturbed state'),
        ("semialgebraic", 'inequalities = ["V <"]', 'disturbance.inequalities: "V <" is no inequality'),
        ("box", "matrix = [[1.0]]", "8 rows of 8"),
        ("ellipsoid", f"matrix = {(-np.eye(8)).tolist()}", "positive definite"),
        ("ball", "", "disturbance.set must be"),
    ],
)
def test_mistakes_are_named_in_one_sentence(kind, lines, said):
    with pytest.raises(InputError, match=said) as caught:
        made(kind, lines)
    assert "\n" not in str(caught.value)
