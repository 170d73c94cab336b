"""Sets of disturbances: what each says of itself agrees with the others, with samples, and with known answers."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube import sos
from aerotube.errors import InputError
from aerotube.tube import (
    DisturbanceBox,
    DisturbanceEllipsoid,
    DisturbancePolytope,
    SemialgebraicSet,
    ellipsoid,
    least_volume_around_points,
)
from tests.samples import HALF_WIDTHS as W

UNIT = np.eye(8, dtype=int)
PARTS = [(0, 1, 2, 3), (4, 5, 6, 7), tuple(range(8))]


def polynomial(terms):
    """Of ``{exponents: coefficient}``, a single index standing for a square of that error over its width."""
    exponents = [np.zeros(8, dtype=int) if key == () else 2 * UNIT[key] for key in terms]
    scale = [1.0 if key == () else W[key] ** -2 for key in terms]
    return sos.Polynomial(np.array(exponents), np.array(list(terms.values())) * scale)


BOX = DisturbanceBox(W)
SETS = {
    "box": BOX,
    "box by its sides": DisturbancePolytope(np.vstack([np.diag(1 / W), -np.diag(1 / W)]), np.ones(16)),
    "box by polynomials": SemialgebraicSet(2 * W, [polynomial({(): 1.0, i: -1.0}) for i in range(8)]),
    "ellipsoid": DisturbanceEllipsoid.from_half_axes(W),
    "ellipsoid by a polynomial": SemialgebraicSet(1.2 * W, [polynomial({(): 1.0} | dict.fromkeys(range(8), -1.0))]),
    "cross-polytope": DisturbancePolytope.from_vertices(np.vstack([np.diag(W), -np.diag(W)])),
}


def shapes(rng, errors, count=2):
    own, n = W[list(errors)], len(errors)
    a = rng.normal(size=(count, n, n))
    return (a @ np.swapaxes(a, 1, 2) + np.eye(n)) / (own[:, None] * own)


@pytest.mark.parametrize("name", SETS)
def test_samples_are_inside_and_within_reach(name):
    given_set, rng = SETS[name], np.random.default_rng(10)
    points, directions = given_set.sample(600, rng), rng.normal(size=(5, 8)) / W
    assert given_set.contains(points).all()
    assert not given_set.contains(3.0 * given_set.half_widths)
    reach = given_set.support(directions)
    assert (points @ directions.T <= reach).all()
    assert (np.abs(points) <= given_set.half_widths).all()
    axes = given_set.support(np.concatenate([np.diag(1 / W), -np.diag(1 / W)]))
    assert axes == pytest.approx(np.ones(16), rel=1e-6)  # all six reach one width along every axis
    assert np.abs((points / W).mean(0)).max() < 6 / np.sqrt(600)


@pytest.mark.parametrize("errors", PARTS)
@pytest.mark.parametrize("name", SETS)
def test_ellipsoids_hold_the_set_and_are_tight(name, errors):
    given_set, rng = SETS[name], np.random.default_rng(11)
    points = given_set.sample(200, rng)[:, errors]
    shape, rho = given_set.least_volume(errors)
    assert ellipsoid.contains(shape, rho, points).all()
    forms = shapes(rng, errors)
    least = given_set.least_size(errors, forms)
    assert ellipsoid.contains(forms[:, None], least[:, None], points).all()
    # the ellipsoid of least volume has the least size of its own shape
    assert given_set.least_size(errors, shape[None])[0] == pytest.approx(rho, rel=1e-6)
    corners = given_set.corners(errors)
    if corners is not None:
        assert np.einsum("vi,bij,vj->bv", corners, forms, corners).max(1) == pytest.approx(least)


@pytest.mark.parametrize("errors", PARTS)
@pytest.mark.parametrize(("one", "other"), [("box", "box by its sides"), ("ellipsoid", "ellipsoid by a polynomial")])
def test_one_set_told_in_two_ways_gives_the_same(one, other, errors):
    rng = np.random.default_rng(12)
    own = np.outer(W[list(errors)], W[list(errors)])
    (first, a), (second, b) = (SETS[name].least_volume(errors) for name in (one, other))
    assert second / b * own == pytest.approx(first / a * own, abs=1e-6)
    forms = shapes(rng, errors, 4)
    assert SETS[other].least_size(errors, forms) == pytest.approx(SETS[one].least_size(errors, forms), rel=1e-6)
    directions = rng.normal(size=(5, 8)) / W
    assert SETS[other].support(directions) == pytest.approx(SETS[one].support(directions), rel=1e-6)


@pytest.mark.parametrize("errors", PARTS)
def test_a_box_by_polynomials_has_the_ellipsoid_of_the_box(errors):
    """And a program of a higher degree closes the gap of the lower one for a shape that is not the box's own."""
    box, secret = BOX, SETS["box by polynomials"]
    own = np.outer(W[list(errors)], W[list(errors)])
    shape, rho = secret.least_volume(errors)
    assert shape / rho * len(errors) * own == pytest.approx(np.eye(len(errors)), abs=1e-6)
    forms = shapes(np.random.default_rng(13), errors, 4)
    exact, bound = box.least_size(errors, forms), secret.least_size(errors, forms)
    assert (bound >= exact * (1 - 1e-9)).all()
    assert (bound <= exact * 1.1).all()
    if len(errors) == 4:
        finer = SemialgebraicSet(secret.half_widths, secret.inequalities, degree=4)
        assert (finer.least_size(errors, forms) <= bound * (1 + 1e-7)).all()
        assert finer.least_size(errors, forms) == pytest.approx(exact, rel=1e-5)


@given(st.integers(0, 10_000), st.integers(2, 5))
@settings(max_examples=20, deadline=None)
def test_loewner_ellipsoids_that_are_known(seed, n):
    """A cross-polytope's and a simplex's are balls; an affine map takes the one of a body to that of its image."""
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=(n, n)) + 2 * np.eye(n)
    inverse = np.linalg.inv(turn)
    cross = np.concatenate([np.eye(n), -np.eye(n)])
    simplex = np.linalg.qr(np.column_stack([np.ones(n + 1), np.eye(n + 1)[:, :n]]))[0][:, 1:]
    for points, radius in ((cross, 1.0), (simplex, np.sqrt(n / (n + 1)))):
        shape, rho = least_volume_around_points(points @ turn.T)
        expected = inverse.T @ inverse / radius**2
        assert shape / rho == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


@given(st.integers(0, 10_000), st.integers(2, 4), st.integers(0, 6))
@settings(max_examples=20, deadline=None)
def test_no_ellipsoid_around_points_has_less_volume(seed, n, more):
    """John's condition: the centred ellipsoid of least volume has contact points whose moments make its inverse."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n + more, n))
    shape, rho = least_volume_around_points(points)
    assert ellipsoid.contains(shape, rho, points).all()
    volume = ellipsoid.log_volume(shape, rho)
    for _ in range(20):
        change = 0.05 * rng.normal(size=(n, n))
        other = shape + shape @ (change + change.T) @ shape / np.linalg.norm(shape)
        if np.linalg.eigvalsh(other)[0] > 0:
            size = np.einsum("ui,ij,uj->u", points, other, points).max()
            assert ellipsoid.log_volume(other, size) >= volume - 1e-6


def test_two_balls_meet_in_what_their_ellipsoid_holds():
    """Two unit balls about (0, +-h): the lens is a body of revolution; its ellipse is found by search in the plane."""
    height = 0.5
    along, across = np.zeros(8, dtype=int), 2 * UNIT
    inequalities = [
        sos.Polynomial(
            np.array([along, across[0], across[1], UNIT[1]]), np.array([1.0 - height**2, -1.0, -1.0, sign * 2 * height])
        )
        for sign in (1.0, -1.0)
    ]
    lens = SemialgebraicSet(np.ones(8), inequalities, degree=4).tightened()
    assert lens.half_widths[:2] == pytest.approx([np.sqrt(1 - height**2), 1 - height], rel=1e-5)
    shape, rho = lens.least_volume((0, 1))
    angle = np.linspace(0.0, np.pi, 20001)
    x = np.stack([np.sin(angle), np.cos(angle) - height], axis=-1)
    x = x[x[:, 1] >= 0]
    ratios = np.geomspace(0.1, 10.0, 4001)
    sizes = (x[:, 0] ** 2 + ratios[:, None] * x[:, 1] ** 2).max(axis=1)
    best = (sizes / np.sqrt(ratios)).min()
    assert rho / np.sqrt(np.linalg.det(shape)) == pytest.approx(best, rel=1e-4)


def test_polytopes_are_the_same_by_sides_and_by_vertices():
    rng = np.random.default_rng(14)
    points, directions = rng.normal(size=(10, 8)) * W, rng.normal(size=(20, 8)) / W
    hull = DisturbancePolytope.from_vertices(np.concatenate([points, -points]))
    assert hull.support(directions) == pytest.approx(np.abs(points @ directions.T).max(axis=0), rel=1e-8)
    assert hull.half_widths == pytest.approx(np.abs(points).max(axis=0), rel=1e-8)
    assert hull.contains(0.999 * points).all()
    assert not hull.contains(1.001 * points).any()
    for errors in PARTS[:2]:
        reach = np.abs(points[:, errors] @ directions[:, errors].T).max(axis=0)
        assert (hull.corners(errors) @ directions[:, errors].T).max(axis=0) == pytest.approx(reach, rel=1e-8)
    # a box with some of its corners cut off
    sides = np.concatenate([np.eye(8), -np.eye(8), np.sign(rng.normal(size=(3, 8)))]) / W
    cut = DisturbancePolytope(sides, np.repeat([1.0, 6.5], [16, 3]))
    assert len(cut.vertices) == 253 + 3 * 8
    assert np.isclose(cut.vertices @ sides.T, np.repeat([1.0, 6.5], [16, 3]), rtol=1e-7).sum(axis=1).min() >= 8


@pytest.mark.parametrize("name", SETS)
def test_what_was_found_out_is_not_saved(name):
    """A set is the same before and after it was used: synthesis keeps what it made by the set's content."""
    given_set = SETS[name]
    fresh = pickle.loads(pickle.dumps(given_set))
    before = pickle.dumps(fresh)
    fresh.least_volume((0, 1, 2, 3))
    assert pickle.dumps(fresh) == before


def bad(words, make):
    return pytest.param(make, words, id=words)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        bad("half-width of q is 0", lambda: DisturbanceBox(W * (UNIT[2] == 0))),
        bad("give eight", lambda: SemialgebraicSet(W[:4], [])),
        bad("relative change of mass is 1.5", lambda: DisturbanceEllipsoid(np.eye(8), {"mass": 1.5})),
        bad("not symmetric and positive definite", lambda: DisturbanceEllipsoid(np.diag([1.0] * 7 + [-1.0]))),
        bad("8 by 8", lambda: DisturbanceEllipsoid(np.eye(4))),
        bad("normals \\(m, 8\\)", lambda: DisturbancePolytope(np.eye(4), np.ones(4))),
        bad("offsets positive", lambda: DisturbancePolytope(np.eye(8), np.zeros(8))),
        bad("does not bound V", lambda: DisturbancePolytope(np.eye(8), np.ones(8))),
        bad("lie in a plane", lambda: DisturbancePolytope.from_vertices(np.eye(8))),
        bad("finite \\(k, 8\\)", lambda: DisturbancePolytope.from_vertices(np.eye(4))),
        bad("inequality 0 has 2 variables", lambda: SemialgebraicSet(W, [sos.Polynomial([[2, 0]], [1.0])])),
        bad("odd or too low", lambda: SemialgebraicSet(W, [], degree=3)),
        bad("cannot be used", lambda: SemialgebraicSet(W, [polynomial({(): -1.0, 0: -1.0})]).least_volume((0, 1))),
        bad("span all 3 dimensions", lambda: least_volume_around_points(np.eye(3)[:2])),
    ],
)
def test_mistakes_are_named(make, words):
    with pytest.raises(InputError, match=words):
        make()
