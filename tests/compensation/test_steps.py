"""Two and three steps, joint ellipsoids, mixtures, the increment form, workers."""

import numpy as np
import pytest

from aerotube import sos
from aerotube.compensation import SynthesisSettings, design, exact_map
from aerotube.compensation.closed_loop import end_errors
from aerotube.compensation.groundwork import groundwork
from aerotube.compensation.reasons import why
from aerotube.compensation.settings import DECOUPLED
from aerotube.compensation.terminal import terminal_ellipsoid
from tests.samples import BOX, aircraft, table2

BEATS = 2


def made(workers=1, **settings):
    return design(aircraft(), table2(BEATS), BOX, SynthesisSettings(**settings), workers=workers)


def ends(result, index):
    part = result.settings.parts[index]
    plane, nominal = aircraft(), table2(BEATS)
    ground = groundwork(plane, nominal, BOX, result.settings)
    nodes = exact_map.size_structure(4, 2, 4).nodes("tube/0")
    points = np.einsum("bij,uj->bui", ground.parts[index].initial.whitening, nodes)
    return end_errors(
        plane, nominal, result.beats, result.law.coordinates, part, points, ground.vertices, result.law
    ), ground.parts[index].metric


@pytest.mark.parametrize("index", [0, 1])
def test_the_third_step_is_never_worse_in_its_own_size(index):
    """The held shape at its least rho is one of the ellipsoids that the third step chooses from."""
    end, metric = ends(made(), index)
    held = terminal_ellipsoid(end, metric, "rho")
    volume, trace = (terminal_ellipsoid(end, metric, size) for size in ("volume", "trace"))

    def log_volume(one):
        return 4 * np.log(one.rho) - np.linalg.slogdet(one.shape)[1]

    def squares(one):
        return one.rho * np.trace(metric @ np.linalg.inv(one.shape), axis1=1, axis2=2)

    for best, others, size in ((volume, (held, trace), log_volume), (trace, (held, volume), squares)):
        for other in others:
            assert (size(best) <= size(other) + 1e-5 * np.abs(size(other))).all()
    for one in (held, volume, trace):
        value = np.einsum("bkui,bij,bkuj->bku", end, one.shape, end)
        assert (value.max((1, 2)) <= one.rho * (1 + 1e-9)).all()


def test_three_steps_have_the_law_of_two_and_an_ellipsoid_of_their_own():
    two, three = made(), made(steps="three-step")
    np.testing.assert_array_equal(two.law.gains, three.law.gains)
    assert two.terminal is None
    assert two.step_seconds.shape[-1] == 1
    assert three.step_seconds.shape[-1] == 2
    end, _ = ends(three, 0)
    value = np.einsum("bkui,bij,bkuj->bku", end, three.terminal[0].shape, end)
    assert (value.max((1, 2)) <= three.terminal[0].rho * (1 + 1e-9)).all()


def test_an_ellipsoid_found_with_the_law_is_smaller_than_one_found_after_it():
    together, after = made(size="trace", control_weight=1e-6), made(size="worst-case", control_weight=1e-6)
    for index in (0, 1):
        sizes = []
        for result in (together, after):
            end, metric = ends(result, index)
            found = terminal_ellipsoid(end, metric, "trace")
            sizes.append(found.rho * np.trace(metric @ np.linalg.inv(found.shape), axis1=1, axis2=2))
        assert (sizes[0] <= 1.02 * sizes[1]).all()


def test_a_mixture_lies_between_its_sizes():
    weights = {"worst-case": 1.0, "mean-square": 1.0}
    worst, mean, both = (made(size=size, control_weight=1e-6) for size in ("worst-case", "mean-square", weights))
    assert (both.bound >= (worst.bound + mean.bound) * (1 - 1e-5)).all()
    one = made(size={"mean-square": 2.0}, control_weight=1e-6)
    np.testing.assert_allclose(one.bound, 2.0 * mean.bound, rtol=1e-5)


@pytest.mark.parametrize("steps", ["two-step", "three-step"])
def test_the_increment_form_claims_no_more_rho_than_without_a_law_and_the_shape_stays_above_its_start(steps):
    """Freeing the shape cannot lessen rho: raising E only tightens (both forms have one optimum)."""
    result = made(formulation="increment", steps=steps, law_degree=1)
    held = made(formulation="increment", steps="three-step", law_degree=1)
    assert result.feasible.all()
    np.testing.assert_allclose(result.bound, held.bound, rtol=1e-4)
    assert len(result.terminal) == 2
    assert all((np.linalg.eigvalsh(one.shape) > 0).all() for one in result.terminal)
    assert np.abs(result.law.gains).max() > 0


@pytest.mark.parametrize("change", [{"reuse": 1}, {"law_degree": 2}, {"formulation": "increment"}])
def test_workers_do_not_change_the_numbers(change):
    one, two = made(**change), made(workers=2, **change)
    np.testing.assert_array_equal(one.law.gains, two.law.gains)
    np.testing.assert_array_equal(one.bound, two.bound)


def test_an_infeasible_program_says_which_requirements_collide():
    program = sos.Program()
    program.scalar("d")
    program.linear("limit/0", rows=1)
    program.linear("limit/1", rows=1)
    structure = program.compile()
    data = structure.data(
        objective=np.ones((1, 1)),
        constraints={"limit/0": (np.ones((1, 1)), -np.ones(1)), "limit/1": (-np.ones((1, 1)), -np.ones(1))},
    )
    text = why(sos.solve(structure, data), 0, ["elevator", "thrust"])
    assert "limit of the elevator" in text
    assert "limit of the thrust" in text
    assert "missed by" in text


@pytest.mark.parametrize("size", ["trace", "volume"])
def test_noise_counts_where_the_ellipsoid_is_found_with_the_law(size):
    """The law told of noise is worth more than the one that is not, noise counted for both by its own covariance."""
    plane, nominal = aircraft(), table2(BEATS)
    settings = {"size": size, "shape": "riccati", "control_weight": 1e-6}  # a metric that does not know of noise
    deaf, told = made(**settings), made(noise_weight=1.0, **settings)
    ground = groundwork(plane, nominal, BOX, told.settings)

    def heard(result, index, part):
        """Covariance that noise adds at the end, in the metric: (beats, n, n)."""
        e, c = list(part.errors), list(part.controls)
        root = np.swapaxes(np.linalg.cholesky(result.metric[index]), 1, 2)
        moved = root[:, None] @ ground.input_map[:, :, e][..., c] @ result.law.gains[:, None][:, :, c][..., e]
        return (moved @ ground.expected.noise[:, None][:, :, e][..., e] @ np.swapaxes(moved, -1, -2)).mean(1)

    for index, part in enumerate(DECOUPLED):
        added = [np.trace(heard(result, index, part), axis1=1, axis2=2) for result in (deaf, told)]
        assert (added[1] < added[0]).all()
        if size == "trace":
            assert (told.bound[:, index] <= (deaf.bound[:, index] + added[0]) * (1 + 1e-5)).all()
            assert (told.bound[:, index] >= (deaf.bound[:, index] + added[1]) * (1 - 1e-5)).all()
