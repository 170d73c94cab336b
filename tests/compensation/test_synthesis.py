import itertools
from dataclasses import replace

import numpy as np
import pytest

from aerotube import sos
from aerotube.compensation import (
    DECOUPLED,
    SynthesisSettings,
    boundary,
    design,
    exact_map,
    gauge,
    law_program,
    limits,
    synthesise,
)
from aerotube.compensation.groundwork import effort_weights, expectations
from aerotube.dynamics import error_map
from aerotube.errors import InputError
from aerotube.nominal import constant_controls
from aerotube.tube import DisturbanceBox, ellipsoid
from tests.samples import BOX, HALF_WIDTHS, TABLE2_CONTROL, aircraft, table2, table2_state

BEATS = 3
POLYNOMIAL = SynthesisSettings(certificate="polynomial only")
TINY = DisturbanceBox(1e-4 * HALF_WIDTHS, {})


@pytest.fixture(scope="module")
def made():
    return synthesise(aircraft(), table2(BEATS), BOX, POLYNOMIAL)


def whitened(made, index):
    tubes = made.tubes
    return ellipsoid.whitening(tubes.initial_shape[:, index], tubes.initial_rho[:, index])


def test_every_beat_has_a_law_of_its_own_half(made):
    assert made.feasible.all()
    assert made.messages == []
    gains = made.law.gains
    assert (gains[:, :2, 4:] == 0).all()
    assert (gains[:, 2:, :4] == 0).all()
    assert np.isfinite(gains).all()
    np.testing.assert_allclose(made.law.increment(1, HALF_WIDTHS), gains[1] @ HALF_WIDTHS)
    assert (made.tubes.certificate == "polynomial only").all()


@pytest.mark.parametrize("noise_weight", [0.0, 1.0])
def test_for_small_errors_the_law_is_the_regulator_of_the_linearised_map(noise_weight):
    """Second route: the closed form of the mean-square program where the map is linear and limits are far."""
    settings = SynthesisSettings(noise_weight=noise_weight, control_weight=0.1)
    plane, nominal = aircraft(), table2(BEATS)
    result = synthesise(plane, nominal, TINY, settings)
    expected = expectations(plane, nominal, TINY, settings, result.linearisation)
    effort = effort_weights(plane, nominal, 0.1)
    for part in DECOUPLED:
        e, c = list(part.errors), list(part.controls)
        for t in range(BEATS):
            P, M, V = expected.cost[t + 1], expected.moment[t], expected.noise[t][np.ix_(e, e)]
            B = np.zeros((len(P), 4))
            B[:8] = result.linearisation.B[t]
            others = expected.gain[t].copy()
            others[c] = 0.0
            open_loop = expected.step[t].copy()
            open_loop[:, :8] += B @ others
            slope = B[:, c].T @ P @ open_loop @ M[:, e]
            curve, seen = effort[t][np.ix_(c, c)] + B[:, c].T @ P @ B[:, c], M[np.ix_(e, e)] + V
            best = -np.linalg.solve(curve, slope) @ np.linalg.inv(seen)
            without = np.trace(P @ open_loop @ M @ open_loop.T)

            def cost(K, slope=slope, curve=curve, seen=seen, without=without):
                return without + 2 * np.trace(K.T @ slope) + np.trace(K.T @ curve @ K @ seen)

            law = result.law.gains[t][np.ix_(c, e)]
            worth = cost(0 * best) - cost(best)
            assert -1e-12 * cost(best) <= cost(law) - cost(best) <= 1e-3 * worth


@pytest.mark.parametrize("kind", ["box", "ellipsoid"])
@pytest.mark.parametrize("measurement_error", [0.0, 1.0])
def test_limits_hold_where_the_law_sees_them(kind, measurement_error):
    plane, nominal = aircraft(), table2(BEATS)
    settings = SynthesisSettings(limits=kind, measurement_error=measurement_error)
    result = synthesise(plane, nominal, BOX, settings)
    chart = result.law.coordinates
    seen = chart.box(nominal.states[:-1], (1 + measurement_error) * HALF_WIDTHS)
    corners = np.array(list(itertools.product((-1, 1), repeat=8))) * seen[:, None]
    scale = 2.0 if kind == "ellipsoid" else 1.0
    states = chart.retract(nominal.states[:-1, None], scale * corners)
    lower, upper = plane.virtual_limits(states, np.broadcast_to(nominal.controls[:, None], (*states.shape[:2], 4)))
    allowed = np.minimum(-lower, upper).min(1)
    most = np.einsum("tij,tj->ti", np.abs(result.law.gains), seen)
    assert (most <= allowed * (1 + 1e-12)).all()
    push = np.einsum("tij,tcj->tci", result.law.gains, corners)
    states = chart.retract(nominal.states[:-1, None], corners)
    lower, upper = plane.virtual_limits(states, np.broadcast_to(nominal.controls[:, None], push.shape))
    assert (push >= lower - 1e-9 * np.abs(lower)).all()
    assert (push <= upper + 1e-9 * np.abs(upper)).all()
    if kind == "box":
        assert (most[:, 1] > 0.99 * allowed[:, 1]).all()
    else:
        over_the_ellipsoid = np.sqrt(4 * np.einsum("tij,tj->ti", result.law.gains**2, seen**2))
        assert (over_the_ellipsoid <= allowed * (1 + 1e-12)).all()
        assert (over_the_ellipsoid[:, 1] > 0.99 * allowed[:, 1]).all()


def test_limits_in_many_errors_are_those_at_every_corner(monkeypatch):
    """Second route: a row for each of the 256 corners of the box, for each control."""
    settings = SynthesisSettings(algorithm="coupled", noise_weight=1.0, measurement_error=1.0)

    def made():
        law_program.structure.cache_clear()
        return design(aircraft(), table2(BEATS), BOX, settings)

    found = made()
    monkeypatch.setattr(limits, "_FEW", 8)
    expected = made()
    law_program.structure.cache_clear()
    np.testing.assert_allclose(found.bound, expected.bound, rtol=1e-6)
    scale = HALF_WIDTHS * np.array([1.0, 1e-5, 1.0, 1.0])[:, None]
    np.testing.assert_allclose(found.law.gains * scale, expected.law.gains * scale, rtol=0, atol=1e-4)


@pytest.mark.parametrize(("which", "width", "words"), [
    (0, 150.0, "at beat 0 the Mach number"),
    (1, np.radians(15.0), "at beat 0 the angle of attack is 49"),
])  # fmt: skip
def test_disturbances_beyond_the_model_are_refused(which, width, words):
    widths = HALF_WIDTHS.copy()
    widths[which] = width
    with pytest.raises(InputError, match=f"disturbance: .*{words}.* choose smaller disturbances"):
        design(aircraft(), table2(BEATS), DisturbanceBox(widths, {"mass": 0.05}), SynthesisSettings())
    nominal = table2(BEATS)
    with pytest.raises(InputError, match=words):
        gauge(aircraft(), nominal.states[0], nominal.controls[0], DisturbanceBox(widths, {"mass": 0.05}))


def test_a_tube_that_would_hold_no_airspeed_is_refused():
    """The box leaves 10 m/s, and a model without ranges does not mind."""

    class Anywhere(type(aircraft())):
        domain = ()

        def domain_values(self, state):
            return ()

    plane, widths = Anywhere(), HALF_WIDTHS.copy()
    nominal = constant_controls(plane, table2_state(), TABLE2_CONTROL, 0.05, BEATS)
    widths[0] = 0.6 * np.linalg.norm(nominal.states[0, :3])
    with pytest.raises(InputError, match=r"at beat \d the airspeed would be -"):
        design(plane, nominal, DisturbanceBox(widths, {"mass": 0.05}), SynthesisSettings())


def ends(made, index, error, sigma):
    """Errors at the end of each beat under the law, of one half, on the true map."""
    part = made.tubes.parts[index]
    full = np.zeros((BEATS, *error.shape[1:-1], 8))
    full[..., part.errors] = error
    push = np.einsum("tij,t...j->t...i", made.law.gains, full)
    end = error_map(
        aircraft(), table2(BEATS), range(BEATS), made.law.coordinates, full, increment=push, parameters=sigma
    )
    return end[..., part.errors]


def sphere(rng, *shape):
    z = rng.normal(size=(*shape, 4))
    return z / np.linalg.norm(z, axis=-1, keepdims=True)


def monomials(z, degrees):
    """All of some degrees; those of three and four are a basis of the polynomials of degree four on the sphere."""
    powers = [p for p in itertools.product(range(5), repeat=4) if sum(p) in degrees]
    return np.stack([np.prod(z**p, axis=-1) for p in powers], axis=-1)


@pytest.mark.parametrize("index", [0, 1])
def test_tubes_hold_the_interpolant_of_the_true_map(made, index):
    """Second route: the polynomial through the values at the nodes, in monomials, on a dense sample.

    Sizes are of the polynomials through nodes of the sphere, terminal ellipsoids of those through nodes of the ball.
    """
    tubes, dense = made.tubes, sphere(np.random.default_rng(index), 4000)
    on_sphere, in_ball = exact_map.size_structure(4, 2, 4).nodes("tube/0"), boundary.nodes(4, 4)
    deep = dense * np.random.default_rng(2).random((len(dense), 1)) ** 0.25
    cases = (
        (tubes.metric, tubes.size, on_sphere, dense, (3, 4)),
        (tubes.terminal_shape, tubes.terminal_rho, in_ball, np.concatenate([dense, deep]), range(5)),
    )
    for sigma, (shape, rho, nodes, points, degrees) in itertools.product(BOX.parameter_vertices(aircraft()), cases):
        interpolate = monomials(points, degrees) @ np.linalg.inv(monomials(nodes, degrees))
        error = np.einsum("tij,uj->tui", whitened(made, index), nodes)
        end = ends(made, index, error, np.broadcast_to(sigma, (BEATS, 1, 1)))
        value = np.einsum("tui,tij,tuj->tu", end, shape[:, index], end)
        assert (value @ interpolate.T <= rho[:, index, None] * (1 + 1e-12)).all()
        assert (value.max(1) > 0.7 * rho[:, index]).all()


@pytest.mark.parametrize("index", [0, 1])
def test_the_true_map_exceeds_its_interpolant_by_little(made, index):
    """In the metric of the synthesis, by five percent at most (what the certificate does not cover)."""
    rng = np.random.default_rng(index)
    error = np.einsum("tij,tuj->tui", whitened(made, index), sphere(rng, BEATS, 400))
    sigma = BOX.parameter_vertices(aircraft())[rng.integers(0, 2, (BEATS, 400))]
    end = ends(made, index, error, sigma)
    value = np.einsum("tui,tij,tuj->tu", end, made.tubes.metric[:, index], end)
    assert (value.max(1) < 1.05 * made.tubes.size[:, index]).all()


def test_compensation_makes_the_tube_smaller(made):
    assert (made.tubes.size < made.tubes.size_nominal).all()
    volume = [-np.linalg.slogdet(shape)[1] for shape in (made.tubes.terminal_shape, made.tubes.nominal_shape)]
    assert (volume[0] < volume[1]).all()


def test_the_worst_case_law_has_the_least_worst_case():
    """For small errors, where the control enters linearly as the program assumes."""
    plane, nominal = aircraft(), table2(BEATS)
    small = DisturbanceBox(1e-3 * HALF_WIDTHS, {})
    worst = synthesise(plane, nominal, small, SynthesisSettings(size="worst-case", control_weight=1e-9))
    mean = synthesise(plane, nominal, small, SynthesisSettings(control_weight=1e-9))
    np.testing.assert_allclose(worst.bound, worst.tubes.polynomial_size, rtol=1e-5)
    assert (worst.tubes.polynomial_size <= mean.tubes.polynomial_size * (1 + 1e-5)).all()


def test_a_control_on_its_limit_is_left_alone():
    control = TABLE2_CONTROL.copy()
    control[3] = aircraft().control_upper[3]
    nominal = constant_controls(aircraft(), table2_state(), control, 0.05, 1)
    result = synthesise(aircraft(), nominal, BOX)
    assert result.feasible.all()
    assert (result.law.gains[:, 3] == 0).all()
    assert np.abs(result.law.gains[:, 2]).max() > 0


def test_workers_do_not_change_the_numbers(made):
    two = synthesise(aircraft(), table2(BEATS), BOX, POLYNOMIAL, workers=2)
    np.testing.assert_array_equal(two.law.gains, made.law.gains)
    np.testing.assert_array_equal(two.tubes.size, made.tubes.size)


def test_a_beat_without_a_law_is_named_and_flown_on_the_nominal_alone(monkeypatch):
    solve = sos.solve

    def failing(structure, data, **options):
        solution = solve(structure, data, **options)
        if len(structure.variables) > 1:  # both halves in one batch
            failed = np.arange(2 * BEATS) % BEATS == 1
            solution = replace(solution, status=np.where(failed, sos.Status.INFEASIBLE, solution.status))
        return solution

    monkeypatch.setattr(sos, "solve", failing)
    result = synthesise(aircraft(), table2(BEATS), BOX)
    assert not result.feasible[1].any()
    assert result.feasible[[0, 2]].all()
    assert (result.law.gains[1] == 0).all()
    assert len(result.messages) == 2
    assert "beat 1, longitudinal" in result.messages[0]
    assert "infeasible" in result.messages[0]
    np.testing.assert_allclose(result.tubes.size[1], result.tubes.size_nominal[1], rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"size": "small"}, "size"),
        ({"noise_weight": -1.0}, "noise_weight"),
        ({"control_weight": 0.0}, "control_weight"),
        ({"degree": 3}, "degree"),
        ({"algorithm": "three-step"}, "algorithm"),
    ],
)
def test_settings_out_of_range_are_named(change, words):
    with pytest.raises(InputError, match=words):
        SynthesisSettings(**change)
