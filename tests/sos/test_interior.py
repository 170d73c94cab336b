"""The interior-point method: agreement with a second solver, optimality conditions, outcomes."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from aerotube import sos
from aerotube.sos import Status
from aerotube.sos.backends import interior
from aerotube.sos.residuals import adjoint, gram_values, moment_matrices
from tests.sos.programs import maximum_data, maximum_program, tube_data, tube_program


@pytest.mark.parametrize("seed", range(4))
def test_the_optimum_is_that_of_another_solver(tube, seed):
    data = tube_data(tube, seed, limit=0.2 + 0.1 * seed)
    ours = sos.solve(tube, data)
    other = sos.solve(tube, data, backend="clarabel")
    assert ours.optimal
    assert other.optimal
    np.testing.assert_allclose(ours.objective, other.objective, rtol=1e-6)


def test_optimality_conditions_hold_in_the_programs_own_units(tube):
    data = tube_data(tube, 7)
    solution = sos.solve(tube, data, tolerance=1e-8)
    objective, arrays = data.one(0)
    gradient = adjoint(tube, arrays, solution.multipliers)
    np.testing.assert_allclose(gradient, objective, atol=1e-7)
    for name in ("tube/0", "tube/1"):
        (gram,) = solution.grams[name]
        value = arrays[name]["c"] + arrays[name]["C"] @ solution.values
        np.testing.assert_allclose(gram_values(tube.sampling(name), [gram]), value, atol=1e-8)
        (moment,) = moment_matrices(tube.sampling(name), solution.multipliers[name])
        assert np.linalg.eigvalsh(gram)[0] > 0
        assert np.linalg.eigvalsh(moment)[0] > -1e-10
        assert abs(np.sum(gram * moment)) < 1e-6
    K = solution["K"]
    assert np.all(np.linalg.norm(K, axis=1) < 0.5)


def test_a_program_with_every_kind_of_constraint():
    program = sos.Program()
    x = program.matrix("x", (3,))
    program.sos("positive", sos.Product(sos.Sphere(2), sos.Interval()), 4)
    program.lmi("matrix", 2)
    program.norm("length", 3)
    program.linear("sum", 2)
    structure = program.compile()
    z = structure.nodes("positive")
    values = np.stack([np.ones(len(z)), z[:, 0] * z[:, 2], z[:, 1] ** 2 - z[:, 2] ** 2], axis=1)
    F = np.zeros((3, 2, 2))
    F[1] = [[0.0, 1.0], [1.0, 0.0]]
    F[2] = [[1.0, 0.0], [0.0, -1.0]]
    data = structure.data(
        objective=[0.3, -1.0, 0.5],
        constraints={
            "positive": (np.zeros(len(z)), values),
            "matrix": (np.eye(2), F),
            "length": (np.eye(3), np.zeros(3), np.zeros(3), 2.0),
            "sum": ([[1.0, 1.0, 1.0], [-1.0, 0.0, 0.0]], [1.5, 3.0]),
        },
    )
    assert x.size == 3
    ours, other = sos.solve(structure, data), sos.solve(structure, data, backend="clarabel")
    assert ours.optimal
    np.testing.assert_allclose(ours["x"], other["x"], atol=1e-5)
    np.testing.assert_allclose(ours.objective, other.objective, rtol=1e-6)


def test_minima_on_the_ball_are_exact_for_quadratics():
    # min of z'Az + 2b'z on the unit ball: a trust-region problem, solved by its secular equation.
    rng = np.random.default_rng(0)
    structure = maximum_program(sos.Ball(3), 2)
    for _ in range(5):
        A = rng.standard_normal((3, 3))
        A = A + A.T
        b = rng.standard_normal(3)
        values, vectors = np.linalg.eigh(A)
        low, high = -values[0], -values[0] + 10 * np.linalg.norm(b) + 10
        if low < 0 and np.linalg.norm(np.linalg.solve(A, b)) <= 1:
            shift = 0.0
        else:
            low = max(low, 0.0)
            for _ in range(200):
                shift = 0.5 * (low + high)
                length = np.linalg.norm((vectors.T @ b) / (values + shift))
                low, high = (shift, high) if length > 1 else (low, shift)
        z = -np.linalg.solve(A + shift * np.eye(3), b)
        data = maximum_data(structure, lambda x, A=A, b=b: -np.einsum("ui,ij,uj->u", x, A, x) - 2 * x @ b)
        assert -sos.solve(structure, data)["rho"] == pytest.approx(z @ A @ z + 2 * b @ z, rel=1e-6)


def infeasible_program():
    structure = maximum_program(sos.Sphere(3), 2)
    z = structure.nodes("bound")
    # rho z1^2 >= 1 on the sphere cannot hold where z1 = 0.
    return structure, structure.data(objective=[1.0], constraints={"bound": (-np.ones(len(z)), z[:, :1] ** 2)})


@pytest.mark.parametrize("backend", ["aerotube", "clarabel"])
def test_an_infeasible_program_is_named_with_a_certificate(backend):
    structure, data = infeasible_program()
    solution = sos.solve(structure, data, backend=backend)
    assert solution.status == Status.INFEASIBLE
    y = solution.multipliers["bound"]
    _, arrays = data.one(0)
    scale = -(arrays["bound"]["c"] @ y)
    assert scale > 0
    assert np.max(np.abs(arrays["bound"]["C"].T @ y)) < 1e-6 * scale
    (moment,) = moment_matrices(structure.sampling("bound"), y)
    assert np.linalg.eigvalsh(moment)[0] > -1e-6 * scale


@pytest.mark.parametrize("backend", ["aerotube", "clarabel"])
def test_an_unbounded_program_is_named(backend):
    structure = maximum_program(sos.Sphere(3), 2)
    z = structure.nodes("bound")
    data = structure.data(objective=[-1.0], constraints={"bound": (np.ones(len(z)), np.ones((len(z), 1)))})
    solution = sos.solve(structure, data, backend=backend)
    assert solution.status == Status.UNBOUNDED
    assert solution["rho"] > 0


def test_the_largest_log_determinant_is_that_of_the_least_ellipsoid_around_a_box():
    # E = diag(1 / (n w_i^2)) is the inverse shape of the least ellipsoid around the box |x_i| <= w_i.
    widths = np.array([0.5, 1.0, 3.0])
    program = sos.Program()
    E = program.symmetric("E", 3)
    program.logdet("volume", 3)
    program.linear("corners", 4)
    structure = program.compile()
    F = np.zeros((6, 3, 3))
    for i in range(3):
        for j in range(3):
            F[E[i, j], i, j] = 1.0
    signs = np.array([[1, a, b] for a in (-1, 1) for b in (-1, 1)])
    corners = signs * widths
    A = np.zeros((4, 6))
    for i in range(3):
        for j in range(3):
            A[:, E[i, j]] += corners[:, i] * corners[:, j]
    data = structure.data(
        objective=np.zeros(6), constraints={"volume": (np.zeros((3, 3)), F), "corners": (A, np.ones(4))}
    )
    solution = sos.solve(structure, data)
    assert solution.optimal
    np.testing.assert_allclose(solution["E"], np.diag(1 / (3 * widths**2)), atol=1e-5)
    assert solution.objective == pytest.approx(np.sum(np.log(3 * widths**2)), abs=1e-6)


def test_a_deadline_stops_in_time_and_says_so(tube):
    data = tube_data(tube, 3)
    sos.solve(tube, data, deadline=10.0)
    assert sos.solve(tube, data, deadline=10.0).status == Status.OPTIMAL
    assert sos.solve(tube, data, deadline=1e-9).status == Status.DEADLINE


class Clock:
    """A clock that is one second later whenever it is read."""

    def __init__(self):
        self.now = 0.0

    def perf_counter(self):
        self.now += 1.0
        return self.now


def _stopped(structure, data, monkeypatch):
    """Solutions stopped after every number of iterations but the last, and the one that is not stopped."""
    whole = sos.solve(structure, data)
    monkeypatch.setattr(interior, "time", Clock())
    stopped = []
    for seconds in range(3, 4 + int(whole.iterations)):
        stopped.append(sos.solve(structure, data, deadline=float(seconds)))
    return whole, stopped


@pytest.mark.parametrize("seed", range(4))
def test_a_stopped_solve_answers_with_what_is_certified(tube, seed, monkeypatch):
    whole, stopped = _stopped(tube, tube_data(tube, seed, limit=0.3), monkeypatch)
    assert {Status(int(s.status)) for s in stopped} <= {Status.DEADLINE, Status.OPTIMAL}
    assert len({int(s.iterations) for s in stopped}) > 5
    bounds = [float(s.certificate().bound) for s in stopped]
    # A bound once found is kept or bettered, never lost, and none is below the optimum.
    assert all(later <= earlier for earlier, later in itertools.pairwise(bounds))
    assert bounds[-1] >= whole.objective * (1.0 - 1e-6)
    assert np.isfinite(bounds[len(bounds) // 2])


def test_a_solve_stopped_before_anything_is_certified_says_so(tube, monkeypatch):
    monkeypatch.setattr(interior, "time", Clock())
    solution = sos.solve(tube, tube_data(tube, 0, limit=0.3), deadline=1.0)
    certificate = solution.certificate()
    assert solution.status == Status.DEADLINE
    assert not certificate.holds
    assert certificate.bound == np.inf


def test_threads_do_not_change_the_numbers(tube):
    batch = [tube_data(tube, seed) for seed in range(4)]
    first = batch[0]
    joined = tube.data(
        objective=first.objective,
        constraints={
            name: [np.stack([d.constraints[name][key] for d in batch]) for key in arrays]
            for name, arrays in first.constraints.items()
        },
    )
    one, two = sos.solve(tube, joined), sos.solve(tube, joined, workers=2)
    np.testing.assert_array_equal(one.values, two.values)
    for k, data in enumerate(batch):
        np.testing.assert_array_equal(one.values[k], sos.solve(tube, data).values)


def test_threads_over_constraints_do_not_change_the_numbers(monkeypatch):
    monkeypatch.setattr(interior, "_LARGE", 1)
    structure = tube_program(extremes=3)
    data = tube_data(structure, 1)
    one, three = sos.solve(structure, data), sos.solve(structure, data, threads=3)
    np.testing.assert_array_equal(one.values, three.values)
    assert one.iterations == three.iterations
    late = sos.solve(structure, data, threads=2, deadline=1e-9)
    assert late.status == Status.DEADLINE


@pytest.mark.slow
def test_eight_states():
    structure = tube_program(states=8, inputs=4)
    data = tube_data(structure, 0)
    solution = sos.solve(structure, data)
    assert solution.optimal
    # A second route to the same number: the dual objective from the multipliers alone.
    _, arrays = data.one(0)
    dual = -sum(arrays[f"tube/{k}"]["c"] @ solution.multipliers[f"tube/{k}"] for k in range(2))
    dual -= np.sum(arrays["law"]["F0"] * solution.multipliers["law"])
    dual -= sum(0.5 * solution.multipliers[f"limit/{i}"][0] for i in range(4))
    assert dual == pytest.approx(float(solution.objective), rel=1e-6)


@pytest.mark.parametrize("together", [False, True])
def test_what_has_not_been_compiled_is_compiled_in_a_process_of_its_own(monkeypatch, tmp_path, together):
    """And not again: this process loads what every other one will."""
    asked = []
    monkeypatch.setattr(interior.subprocess, "run", lambda command, **_: asked.append(command[-1]))
    interior.fill_cache(together)
    assert asked == []
    interior._fill_cache(together)
    assert asked == []
    name = "close_step" if together else "through"
    dispatcher = getattr(interior.run, name)
    empty = SimpleNamespace(stats=SimpleNamespace(cache_path=str(tmp_path)), py_func=dispatcher.py_func)
    monkeypatch.setattr(interior, "run", SimpleNamespace(**{name: empty}))
    interior._fill_cache(together)
    assert len(asked) == 1
    assert f"fill_cache({together})" in asked[0]
