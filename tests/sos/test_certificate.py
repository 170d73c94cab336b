"""Certificates: what is claimed holds, at sampled points and in exact arithmetic."""

import numpy as np
import pytest

from aerotube import sos
from aerotube.sos import Status
from tests.sos.programs import maximum_data, maximum_program, tube_data, tube_program

DOMAINS = [
    (sos.Sphere(3), 4),
    (sos.Ball(2), 4),
    (sos.Product(sos.Sphere(2), sos.Interval()), 4),
    (sos.Product(sos.Ball(1), sos.Ball(2)), 4),
]


def random_polynomial(domain, degree, seed):
    rng = np.random.default_rng(seed)
    exponents = domain.exponents(degree)
    return sos.Polynomial(exponents, rng.standard_normal(len(exponents)))


@pytest.mark.parametrize(("domain", "degree"), DOMAINS)
def test_a_certified_bound_is_above_every_sampled_value(domain, degree):
    polynomial = random_polynomial(domain, degree, 1)
    structure = maximum_program(domain, degree)
    solution = sos.solve(structure, maximum_data(structure, polynomial))
    certificate = solution.certificate()
    assert solution.optimal
    assert certificate.holds
    values = polynomial(domain.sample(20000, seed=4))
    assert certificate.bound >= values.max()
    assert certificate.bound <= values.max() + 0.1 * np.ptp(values)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-7])
def test_the_optimum_of_a_tube_is_certified(tube, tolerance):
    for seed in range(5):
        solution = sos.solve(tube, tube_data(tube, seed), tolerance=tolerance)
        certificate = solution.certificate()
        assert solution.optimal
        assert certificate.holds
        assert certificate.bound == solution.objective


@pytest.mark.parametrize(("domain", "degree"), DOMAINS)
def test_margins_hold_for_any_decision_feasible_or_not(domain, degree):
    polynomial = random_polynomial(domain, degree, 2)
    structure = maximum_program(domain, degree)
    data = maximum_data(structure, polynomial)
    solution = sos.solve(structure, data, iterations=2)
    certificate = solution.certificate()
    points = domain.sample(20000, seed=5)
    values = solution["rho"] - polynomial(points)
    assert values.min() >= certificate.margins["bound"]
    assert certificate.deficit("bound") == max(0.0, -certificate.margins["bound"])


def test_a_stopped_solve_has_a_margin_that_holds(tube):
    solution = sos.solve(tube, tube_data(tube, 2), deadline=1e-9)
    assert solution.status == Status.DEADLINE
    certificate = solution.certificate()
    _, arrays = solution.data.one(0)
    for name in ("tube/0", "tube/1"):
        at_nodes = arrays[name]["c"] + arrays[name]["C"] @ solution.values
        assert at_nodes.min() >= certificate.margins[name]


@pytest.mark.parametrize(("domain", "degree"), DOMAINS)
def test_a_saved_certificate_is_confirmed_in_exact_arithmetic(domain, degree, tmp_path):
    structure = maximum_program(domain, degree)
    solution = sos.solve(structure, maximum_data(structure, random_polynomial(domain, degree, 3)))
    certificate = solution.certificate()
    certificate.save(tmp_path / "bound.json")
    report = sos.check_file(tmp_path / "bound.json")
    assert report.holds
    assert report.objective == solution.objective
    (finding,) = report.findings
    # The exact margin is the sharper one or nearly so: both bound the same polynomial.
    assert finding.margin > 0.5 * certificate.margins["bound"]


def test_every_kind_of_constraint_is_checked(tube, tmp_path):
    solution = sos.solve(tube, tube_data(tube, 0))
    solution.certificate().save(tmp_path / "tube.json")
    report = sos.check_file(tmp_path / "tube.json")
    assert report.holds
    assert [f.name for f in report.findings] == [c.name for c in tube.constraints]


def test_weights_of_the_user_cut_the_domain(tmp_path):
    # The largest x + y on the quarter of the disc where x <= 0 is 1, at (0, 1).
    half = sos.Polynomial([[1, 0]], [-1.0])
    structure = maximum_program(sos.Ball(2), 4, [half])
    solution = sos.solve(structure, maximum_data(structure, lambda z: z[:, 0] + z[:, 1]))
    assert solution.optimal
    assert solution["rho"] == pytest.approx(1.0, abs=1e-6)
    certificate = solution.certificate()
    assert certificate.holds
    certificate.save(tmp_path / "half.json")
    assert sos.check_file(tmp_path / "half.json").holds


def test_an_infeasible_program_is_explained():
    program = sos.Program()
    program.matrix("x", (2,))
    program.linear("sum", 2)
    program.norm("length", 2)
    structure = program.compile()
    # x1 + x2 >= 3 and |x| <= 1: the nearest miss is along (1, 1).
    data = structure.data(
        objective=[1.0, 0.0],
        constraints={
            "sum": ([[-1.0, -1.0], [1.0, 0.0]], [-3.0, 5.0]),
            "length": (np.eye(2), np.zeros(2), np.zeros(2), 1.0),
        },
    )
    solution = sos.solve(structure, data)
    assert solution.status == Status.INFEASIBLE
    explanation = solution.explain()
    assert {conflict.name for conflict in explanation.conflicts} == {"sum", "length"}
    direction = next(c.direction for c in explanation.conflicts if c.name == "length")
    np.testing.assert_allclose(direction, np.full(2, np.sqrt(0.5)), atol=1e-4)
    # At x = t (1, 1) the violations 3 - 2 t and sqrt(2) t - 1 are equal where both are this large.
    t = 4.0 / (2.0 + np.sqrt(2.0))
    assert 0.99 * (3.0 - 2.0 * t) < explanation.amount <= 3.0 - 2.0 * t
    assert "'sum'" in str(explanation)
    with pytest.raises(ValueError, match="nothing to explain"):
        sos.solve(tube_program(), tube_data(tube_program(), 0)).explain()


def test_the_place_of_a_conflict_is_found():
    structure = maximum_program(sos.Sphere(3), 2)
    z = structure.nodes("bound")
    # 2 rho z1^2 - (1 - z2^2) cannot be made non-negative at (0, 0, +-1).
    values = -(1.0 - z[:, 1] ** 2)
    data = structure.data(objective=[1.0], constraints={"bound": (values, 2.0 * z[:, :1] ** 2)})
    (conflict,) = sos.solve(structure, data).explain().conflicts
    assert abs(conflict.direction[2]) > 0.95
