"""From disturbance sets of every kind to ellipsoids, limits and laws."""

import numpy as np
import pytest

from aerotube import sos
from aerotube.compensation import SynthesisSettings, design
from aerotube.compensation.sets import initial_ellipsoid, linear_image
from aerotube.compensation.settings import COUPLED, DECOUPLED
from aerotube.dynamics import ErrorCoordinates, euler_error
from aerotube.tube import DisturbanceBox, DisturbanceEllipsoid, DisturbancePolytope, SemialgebraicSet, ellipsoid
from tests.samples import HALF_WIDTHS as W
from tests.samples import aircraft, table2

MASS = {"mass": 0.05}
UNIT = np.eye(8, dtype=int)
SIDES = np.concatenate([np.diag(1 / W), -np.diag(1 / W)])
SETS = {
    "box": DisturbanceBox(W, MASS),
    "box by its sides": DisturbancePolytope(SIDES, np.ones(16), MASS),
    "lopsided polytope": DisturbancePolytope(
        np.concatenate([SIDES, [SIDES[0] + SIDES[3], SIDES[8] - SIDES[3], SIDES[4] - SIDES[7]]]),
        [*[1.0] * 16, 0.8, 0.9, 0.7],
        MASS,
    ),
    "ellipsoid": DisturbanceEllipsoid.from_half_axes(W, MASS),
    "semialgebraic": SemialgebraicSet(
        W, [sos.Polynomial([0 * UNIT[0], 4 * UNIT[0], 2 * UNIT[3]], [1.0, -(W[0] ** -4), -(W[3] ** -2)])], MASS
    ),
}
BEATS = 2


def errors_of(given, coordinates, count=3000):
    """Disturbances as the law's coordinates see them: ndarray (BEATS, count, 8)."""
    nominal = table2().states[:BEATS, None]
    drawn = given.sample(count, np.random.default_rng(20))
    if given.corners(range(8)) is not None:
        drawn = np.concatenate([drawn, given.corners(range(8))])
    return coordinates.difference(ErrorCoordinates("euler").retract(nominal, drawn), nominal)


@pytest.mark.parametrize("kind", ["relative", "euler"])
@pytest.mark.parametrize("name", SETS)
def test_ellipsoids_hold_the_disturbances_in_any_coordinates(name, kind):
    given, coordinates = SETS[name], ErrorCoordinates(kind)
    error = errors_of(given, coordinates)
    rng = np.random.default_rng(21)
    # a program of degree four in all eight errors takes seconds
    for part in (*DECOUPLED, *(COUPLED if name != "semialgebraic" else ())):
        own, n = error[..., part.errors], len(part.errors)
        form = rng.normal(size=(BEATS, n, n)) / W[list(part.errors)]
        shapes = np.swapaxes(form, 1, 2) @ form + np.diag(W[list(part.errors)] ** -2.0)
        for shape in (None, shapes):
            found = initial_ellipsoid(given, coordinates, table2().states[:BEATS], part, shape)
            assert ellipsoid.contains(found.shape[:, None], found.rho[:, None], own, 1e-6).all()
            assert (np.abs(own) <= found.widths[:, None] * (1 + 1e-6)).all()
            corners = found.corners
            if corners.shape[1]:
                directions = rng.normal(size=(9, n)) / W[list(part.errors)]
                reach = (corners @ directions.T).max(axis=1)
                assert ((own @ directions.T).max(axis=1) <= reach * (1 + 1e-6)).all()


@pytest.mark.parametrize("part", DECOUPLED)
def test_a_box_told_by_its_sides_is_the_box(part):
    for kind, tolerance in (("euler", 1e-6), ("relative", 0.05)):
        one, other = (
            initial_ellipsoid(SETS[name], ErrorCoordinates(kind), table2().states[:BEATS], part)
            for name in ("box", "box by its sides")
        )
        assert other.widths == pytest.approx(one.widths, rel=tolerance)
        sizes = [ellipsoid.log_volume(x.shape, x.rho) for x in (one, other)]
        assert sizes[1] == pytest.approx(sizes[0], abs=8 * tolerance)


def test_the_linear_image_leaves_out_little():
    """Halving the set quarters what scaling leaves out."""
    states = table2().states[:3]
    scale, margin = linear_image(ErrorCoordinates(), states, W)
    _, smaller = linear_image(ErrorCoordinates(), states, 0.5 * W)
    pitch = np.arcsin(-2 * (states[:, 4] * states[:, 6] - states[:, 3] * states[:, 5]))
    assert scale[:, 7] == pytest.approx(np.cos(pitch))
    assert smaller[:, [3, 7]] == pytest.approx(0.25 * margin[:, [3, 7]], rel=0.05)
    assert (margin[:, 7] < 0.05 * W[7]).all()
    assert not np.delete(margin, [3, 7], axis=1).any()


@pytest.mark.parametrize("measurement", [0.0, 1.0])
@pytest.mark.parametrize("name", SETS)
def test_limits_hold_for_what_the_law_sees(name, measurement):
    """And are used up: with effort cheap, the throttle of the manoeuvre has too little room."""
    given = SETS[name]
    settings = SynthesisSettings(measurement_error=measurement, control_weight=1e-5)
    made = design(aircraft(), table2(), given, settings, beats=range(BEATS))
    assert made.feasible.all()
    error = errors_of(given, made.law.coordinates)
    noise = DisturbanceBox(measurement * W + 1e-12)
    drawn = np.concatenate([noise.sample(500, np.random.default_rng(22)), noise.corners(range(8))])
    states = table2().states[:BEATS, None]
    read = made.law.coordinates.difference(ErrorCoordinates("euler").retract(states, drawn), states)
    push = made.law.increments(np.arange(BEATS), error).max(axis=1) + made.law.increments(np.arange(BEATS), read).max(1)
    lower, upper = aircraft().virtual_limits(table2().states[:BEATS], table2().controls[:BEATS])
    limit = np.minimum(-lower, upper)
    assert (push <= limit * (1 + 1e-3 + 1e-2 * measurement)).all()
    assert (push[:, 1] > 0.4 * limit[:, 1]).all()


def test_a_smaller_set_leaves_the_law_more_room():
    """The ellipsoid in the box lets gains grow; the box by its sides is the box."""
    settings = SynthesisSettings(attitude="euler", control_weight=1e-5)
    gains = {
        name: design(aircraft(), table2(), given, settings, beats=range(1)).law.gains[0] for name, given in SETS.items()
    }
    scale = np.abs(gains["box"]).max(axis=1, keepdims=True)
    assert gains["box by its sides"] / scale == pytest.approx(gains["box"] / scale, abs=1e-3)
    thrust = {name: np.abs(gain[1] * W).sum() for name, gain in gains.items()}
    assert thrust["ellipsoid"] > 1.1 * thrust["box"]


def test_what_is_seen_of_a_cross_is_its_sum_with_the_noise():
    cross = DisturbancePolytope.from_vertices(np.concatenate([np.diag(W), -np.diag(W)]))
    found = initial_ellipsoid(cross, ErrorCoordinates("euler"), table2().states[:1], DECOUPLED[0])
    noise = 0.5 * found.widths
    seen = found.seen_corners(noise)
    directions = np.random.default_rng(23).normal(size=(20, 4)) / W[:4]
    expected = np.abs(directions * W[:4]).max(axis=1) + np.abs(directions * noise).sum(axis=1)
    assert np.abs(seen[0] @ directions.T).max(axis=0) == pytest.approx(expected)
    growth = found.seen_growth(noise)
    assert ellipsoid.contains(found.shape[:, None], (growth**2 * found.rho)[:, None], seen).all()


def test_the_euler_error_is_what_sets_are_in():
    states = table2().states[:1, None]
    drawn = SETS["lopsided polytope"].sample(5, np.random.default_rng(24))
    assert euler_error(ErrorCoordinates("euler").retract(states, drawn), states)[0] == pytest.approx(drawn, abs=1e-9)
