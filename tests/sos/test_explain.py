"""Explanations of infeasibility claim no more than their multipliers prove."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube import sos
from aerotube.sos import Status
from tests.sos.handmade import handmade


def explained(program, constraints, multipliers):
    structure = program.compile()
    data = structure.data(objective=np.zeros(structure.size), constraints=constraints)
    arrays = {name: np.asarray(value, dtype=float) for name, value in multipliers.items()}
    return handmade(structure, data, np.zeros(structure.size), multipliers=arrays, status=Status.INFEASIBLE).explain()


def rows(A, b, y):
    program = sos.Program()
    program.matrix("x", (len(A[0]),))
    program.linear("rows", len(b))
    return explained(program, {"rows": (A, b)}, {"rows": y})


@pytest.mark.parametrize("eps", [1e-6, 1e-9, 1e-10, 1e-12])
def test_a_program_with_large_solutions_is_not_called_infeasible_for_them(eps):
    # x - y >= 1 and y >= (1 - eps) x hold together from x = 1 / eps on, y = x - 1.
    explanation = rows([[-1.0, 1.0], [1.0 - eps, -1.0]], [-1.0, 0.0], [1.0, 1.0])
    smallest = 2.0 / (1.0 - (1.0 - eps)) - 1.0
    assert 0.4 / eps < explanation.radius <= smallest
    assert explanation.amount <= 0.5
    assert f"{explanation.radius:.3g}" in str(explanation)
    assert "infeasible for decisions below" in str(explanation)


def test_what_holds_for_no_decision_is_said_so():
    explanation = rows([[0.0, 0.0]], [-2.0], [3.0])
    assert explanation.radius == np.inf
    assert explanation.doubt == 0.0
    assert 1.99 < explanation.amount <= 2.0
    assert "every decision violates it by 2 at least" in str(explanation)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 10**6))
def test_decisions_within_the_radius_violate_a_constraint(seed):
    rng = np.random.default_rng(seed)
    A, y = rng.standard_normal((5, 3)), rng.uniform(0.0, 1.0, 5)
    A[-1] = -(y[:-1] @ A[:-1]) / y[-1] + rng.choice([0.0, 1e-6, 1e-2]) * rng.standard_normal(3)
    b = rng.standard_normal(5)
    explanation = rows(A, b, y)
    if explanation.radius == 0.0:
        assert y @ b > -1e-12
        return
    d = rng.standard_normal((200, 3))
    d /= np.sum(np.abs(d), axis=1, keepdims=True)
    for size, amount in ((1.0, 0.0), (1e-3, explanation.amount)):
        worst = np.max(min(explanation.radius, 1e6) * size * d @ A.T - b, axis=1)
        assert np.all(worst >= amount)


def matrices():
    program = sos.Program()
    program.scalar("x")
    program.lmi("matrix", 2)
    return program, {"matrix": (np.diag([0.0, 1.0]), np.zeros((1, 2, 2)))}, {"matrix": np.diag([1.0, -0.5])}


def norms():
    program = sos.Program()
    program.scalar("x")
    program.norm("length", 1)
    return program, {"length": ([[0.0]], [1.0], [0.0], 1.5)}, {"length": [1.0, -2.0]}


def lines():
    program = sos.Program()
    program.scalar("x")
    program.linear("rows", 2)
    return program, {"rows": ([[0.0], [0.0]], [0.0, 1.0])}, {"rows": [3.0, -1.0]}


def polynomials():
    program = sos.Program()
    program.scalar("x")
    program.sos("f", sos.Sphere(3), 4)
    structure = program.compile()
    z = structure.nodes("f")
    # A difference of two point evaluations contradicts f = x^2 >= 0, but is no mean of anything.
    square, points = z[:, 0] ** 2, np.eye(len(z))
    functional = 2.0 * points[np.argmin(square)] - points[np.argmax(square)]
    return program, {"f": (square, np.zeros((len(z), 1)))}, {"f": functional}


@pytest.mark.parametrize("case", [matrices, norms, lines, polynomials])
def test_multipliers_outside_their_cones_prove_nothing(case):
    # All these programs are feasible, whatever the decision.
    program, constraints, multipliers = case()
    explanation = explained(program, constraints, multipliers)
    assert explanation.radius == 0.0
    assert explanation.amount == 0.0
    assert explanation.doubt == np.inf
    assert "without proof" in str(explanation)


def test_a_weakly_infeasible_program_keeps_its_radius():
    # [[x, 1], [1, 0]] comes as near to being positive semidefinite as one likes, for x large enough.
    program = sos.Program()
    program.scalar("x")
    program.lmi("matrix", 2)
    F0, F = np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([[[1.0, 0.0], [0.0, 0.0]]])
    for small in (1e-2, 1e-4):
        ray = np.array([[small**2, -small], [-small, 1.0]])
        explanation = explained(program, {"matrix": (F0, F)}, {"matrix": ray})
        assert 0.0 < explanation.radius < 2.0 / small
        # The least eigenvalue of a decision near zero is -1, and -1/x for large ones.
        x = 1e-3 * explanation.radius
        assert explanation.amount <= -np.linalg.eigvalsh(F0 + x * F[0])[0]


def test_a_form_that_is_no_sum_of_squares_is_not_said_to_be_negative():
    # Motzkin's form is not negative anywhere and no sum of squares.
    program = sos.Program()
    program.scalar("t")
    program.sos("form", sos.Sphere(3), 6)
    structure = program.compile()
    x, y, z = structure.nodes("form").T
    values = x**4 * y**2 + x**2 * y**4 + z**6 - 3.0 * x**2 * y**2 * z**2
    data = structure.data(objective=[0.0], constraints={"form": (values, np.zeros((len(values), 1)))})
    explanation = sos.solve(structure, data).explain()
    assert explanation.radius == np.inf
    assert "cannot be written as a sum of squares" in str(explanation)
    # With that much added it is one, so no more can be claimed.
    added = sos.solve(
        structure, structure.data(objective=[1.0], constraints={"form": (values, np.ones((len(values), 1)))})
    )
    assert 0.0 < explanation.amount <= added["t"] * (1.0 + 1e-6)


def test_multipliers_that_are_not_finite_prove_nothing():
    assert rows([[1.0]], [-1.0], [np.nan]).radius == 0.0
    assert rows([[1.0]], [-1.0], [0.0]).radius == 0.0
