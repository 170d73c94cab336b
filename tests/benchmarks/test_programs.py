"""The benchmark programs say what they claim to say, and two solvers that share nothing agree on them."""

from math import comb

import numpy as np
import pytest
from benchmarks.neutral import Linear, Norm, Program, Quotient, Sos, gram_bases, monomials
from benchmarks.solvers import own

from aerotube import sos
from aerotube.dynamics import ErrorCoordinates, error_map
from benchmarks import programs

BEAT = 8


def made(name: str) -> Program:
    return programs.TABLE[name].make([BEAT])[0]


def sphere_times_interval(count: int, n: int) -> np.ndarray:
    return sos.Product(sos.Sphere(n), sos.Interval()).sample(count, seed=7)


# The second solver counts what it leaves violated as feasible: as many digits are asked of it as it can give.
@pytest.mark.parametrize(("name", "digits"), [("lon-map", 1e-10), ("lon-paper", 1e-8)])
def test_two_solvers_agree(name: str, digits: float) -> None:
    prepared = own.prepare(made(name))
    first, second = own.solve(prepared), own.solve(prepared, backend="clarabel", tolerance=digits)
    assert first["status"] == second["status"] == "optimal"
    assert first["objective"] == pytest.approx(second["objective"], rel=2e-6)


def test_the_certified_bound_of_the_map_program_is_its_optimum() -> None:
    answer = own.solve(own.prepare(made("lon-map")))
    assert answer["certified"] == pytest.approx(answer["objective"], rel=1e-6)


def test_the_map_program_in_monomials_is_the_one_of_the_synthesis() -> None:
    structure, data = programs.map_data(programs.LONGITUDINAL, 4)
    theirs = sos.solve(structure, data)
    ours = own.solve(own.prepare(made("lon-map")))
    assert ours["objective"] == pytest.approx(float(theirs.objective[BEAT]), rel=1e-6)


def test_the_table_has_the_sizes_of_the_literature() -> None:
    """U and N of the exact map, and 416 equations of the paper's form with the sphere's multiplier free."""
    nodes = [len(own.prepare(made("lon-map"))[0].nodes(f"mean/{k}")) for k in range(2)]
    assert nodes == [55, 55]
    paper = made("lon-paper")
    blocks = [c for c in paper.constraints if isinstance(c, Sos)]
    assert len(blocks) == 5
    equations = [comb(c.coordinates + 4, 4) for c in blocks]
    assert sum(equations) + 10 == 416


def test_the_paper_tube_is_the_increment_of_the_flown_step() -> None:
    """At no compensation and no terminal shape, rho - f/2 is z' T^-1 (x+ - x) with the true step, to third order."""
    program = made("lon-paper")
    tube = program.constraints[0]
    assert isinstance(tube, Sos)
    points = sphere_times_interval(50, 4)
    setting = programs.manoeuvre("smooth")
    half = list(programs.LONGITUDINAL.errors)
    whitening, low, high = _paper_whitening(setting)
    z, s = points[:, :4], points[:, 4:]
    error = np.zeros((1, len(z), 8))
    error[0][:, half] = z @ whitening.T
    sigma = 0.5 * (low + high) + 0.5 * (high - low) * s
    end = error_map(setting.model, setting.nominal, [BEAT], ErrorCoordinates("euler"), error, parameters=sigma[None])[
        0
    ][:, half]
    increment = np.linalg.solve(whitening, (end - error[0][:, half]).T).T
    expected = -2.0 * np.sum(z * increment, axis=1)
    value = monomials(np.column_stack([z, s]), tube.exponents) @ tube.c
    assert np.max(np.abs(value - expected)) < 2e-2 * np.max(np.abs(expected))


def _paper_whitening(setting):
    from aerotube.compensation.groundwork import effort_weights
    from aerotube.dynamics import linearise
    from aerotube.tube import ellipsoid, parameter_ranges, riccati, tracking_weights

    coordinates, half, pair = ErrorCoordinates("euler"), list(programs.LONGITUDINAL.errors), [0, 1]
    low, high = parameter_ranges(setting.model, setting.disturbance.relative)[0]
    linear = linearise(setting.model, setting.nominal, coordinates, [0.5 * (low + high)])
    one = slice(BEAT, BEAT + 1)
    shape = riccati(
        linear.A[one][:, half][:, :, half],
        linear.B[one][:, half][:, :, pair],
        tracking_weights(setting.nominal.states, coordinates)[BEAT + 1 : BEAT + 2, half][:, :, half],
        effort_weights(setting.model, setting.nominal, setting.settings["noise_free"].control_weight)[one][:, pair][
            :, :, pair
        ],
    )[0]
    rho = ellipsoid.least_size_around_box(shape, setting.disturbance.half_widths[half])
    return ellipsoid.whitening(shape, rho), low, high


def test_limits_hold_where_the_optimal_law_is_flown() -> None:
    """Each side of each limit is 1 minus a law that stays non-negative all over the ball, at the optimum."""
    program = made("lon-paper")
    structure, data = own.prepare(program)
    d = sos.solve(structure, data).values
    z = sos.Ball(4).sample(20000, seed=5)
    limits = [c for c in program.constraints if isinstance(c, Sos) and c.factors == (("ball", 4),)]
    assert len(limits) == 4
    for limit in limits:
        value = monomials(z, limit.exponents) @ (limit.c + limit.C @ d)
        assert value.min() > -1e-7
    below, above = (monomials(z, c.exponents) @ (c.c + c.C @ d) for c in limits[:2])
    # Both sides of a control are one law: what one side gains the other loses.
    assert np.ptp(below + above) < 1e-9


def test_reduction_on_the_sphere_keeps_values() -> None:
    program = made("lon-paper")
    tube = program.constraints[0]
    assert isinstance(tube, Sos)
    quotient = Quotient(tube.factors, tube.degree)
    points = sphere_times_interval(200, 4)
    before = monomials(points, tube.exponents) @ tube.C
    after = monomials(points, quotient.exponents) @ (quotient.matrix(tube.exponents) @ tube.C)
    assert np.max(np.abs(after - before)) < 1e-12 * np.max(np.abs(before))


def test_weighted_squares_have_their_values() -> None:
    """Coefficients of g p'Qp from `Quotient.gram` against evaluation of g and p."""
    factors = (("sphere", 3), ("ball", 1))
    quotient = Quotient(factors, 4)
    points = sphere_times_interval(100, 3)
    generator = np.random.default_rng(0)
    blocks = gram_bases(factors, 4)
    assert [len(weight) for weight, _ in blocks] == [0, 1]
    for weight, basis in blocks:
        gram = generator.standard_normal((len(basis), len(basis)))
        gram = gram + gram.T
        p = monomials(points, basis)
        expected = np.einsum("ui,ij,uj->u", p, gram, p) * (1.0 - points[:, 3] ** 2 if weight else 1.0)
        value = monomials(points, quotient.exponents) @ (quotient.gram(weight, basis) @ gram.ravel())
        assert np.allclose(value, expected, atol=1e-12)


def test_cvxpy_solves_the_same_program() -> None:
    pytest.importorskip("cvxpy")
    from benchmarks.solvers import cvxpy_clarabel

    program = made("lon-map")
    answer = cvxpy_clarabel.solve(cvxpy_clarabel.prepare(program))
    assert answer["status"] == "optimal"
    assert answer["objective"] == pytest.approx(own.solve(own.prepare(program))["objective"], rel=2e-6)


def test_limits_of_the_map_program_are_the_vertices_of_the_box() -> None:
    program = made("lon-map")
    assert [len(c.b) for c in program.constraints if isinstance(c, Linear)] == [16, 16]
    assert [c.name for c in program.constraints if isinstance(c, Norm)] == ["effort"]
