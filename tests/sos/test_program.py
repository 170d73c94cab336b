"""Programs, structures, data, and solutions by the second backend."""

import sys

import numpy as np
import pytest

from aerotube import sos
from aerotube.compensation import SynthesisSettings
from aerotube.errors import InputError
from tests.sos.programs import maximum_data, maximum_program, tube_data, tube_program


def test_variables_pack_and_unpack():
    program = sos.Program()
    program.scalar("rho")
    N = program.symmetric("N", 3)
    K = program.matrix("K", (2, 3))
    rng = np.random.default_rng(0)
    full = rng.standard_normal((5, 3, 3))
    full = full + np.swapaxes(full, 1, 2)
    law = rng.standard_normal((5, 2, 3))
    d = np.zeros((5, program.compile().size))
    d[:, N.slice], d[:, K.slice] = N.pack(full), K.pack(law)
    np.testing.assert_array_equal(N.unpack(d), full)
    np.testing.assert_array_equal(K.unpack(d), law)
    np.testing.assert_array_equal(d[:, N[2, 1]], full[:, 1, 2])
    np.testing.assert_array_equal(d[:, K[1][2]], law[:, 1, 2])


def test_structures_are_equal_by_content():
    assert tube_program() == tube_program()
    assert hash(tube_program()) == hash(tube_program())
    assert tube_program().digest == tube_program().digest
    assert tube_program() != tube_program(extremes=1)
    assert tube_program().digest != tube_program(extremes=1).digest


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_data_that_are_not_finite_are_refused_by_name(tube, bad):
    good = tube_data(tube, 0)
    constraints = {k: [np.array(a) for a in v.values()] for k, v in good.constraints.items()}
    constraints["law"][1][3, 2, 2] = bad
    with pytest.raises(ValueError, match="F of the constraint 'law'"):
        tube.data(objective=good.objective, constraints=constraints)
    late = tube.zeros()
    late.constraints["tube/1"]["c"][4] = bad
    with pytest.raises(ValueError, match="'tube/1'"):
        sos.solve(tube, late, backend="clarabel")


def test_a_backend_that_is_not_there_is_refused(tube, monkeypatch):
    data = tube_data(tube, 0)
    with pytest.raises(ValueError, match="no backend 'sedumi'"):
        sos.solve(tube, data, backend="sedumi")
    monkeypatch.setattr(sys.modules["aerotube.sos.solve"], "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"not installed; install aerotube\[clarabel\]"):
        sos.solve(tube, data, backend="clarabel")
    with pytest.raises(InputError, match="not installed"):
        SynthesisSettings(backend="clarabel")
    assert sos.solve(tube, data).optimal


def test_data_of_the_wrong_shape_or_name_are_refused(tube):
    good = tube_data(tube, 0)
    constraints = {k: tuple(v.values()) for k, v in good.constraints.items()}
    with pytest.raises(ValueError, match="not a constraint"):
        tube.data(objective=good.objective, constraints={**constraints, "lwa": ()})
    with pytest.raises(ValueError, match="'limit/0' has no data"):
        tube.data(objective=good.objective, constraints={k: v for k, v in constraints.items() if k != "limit/0"})
    with pytest.raises(ValueError, match="objective must have the shape"):
        tube.data(objective=np.zeros(3), constraints=constraints)
    with pytest.raises(ValueError, match="another structure"):
        sos.solve(tube_program(extremes=1), good, backend="clarabel")


def test_values_from_monomial_coefficients(tube):
    rng = np.random.default_rng(2)
    exponents = np.array([[0, 0, 0, 0], [1, 2, 0, 1], [0, 0, 4, 0]])
    coefficients = rng.standard_normal((6, 3))
    z = tube.nodes("tube/0")
    expected = coefficients @ np.stack([np.ones(len(z)), z[:, 0] * z[:, 1] ** 2 * z[:, 3], z[:, 2] ** 4])
    np.testing.assert_allclose(tube.values("tube/0", exponents, coefficients), expected, atol=1e-14)


def test_the_largest_eigenvalue_as_a_quadratic_program():
    rng = np.random.default_rng(3)
    matrices = rng.standard_normal((4, 5, 5))
    matrices = matrices + np.swapaxes(matrices, 1, 2)
    structure = maximum_program(sos.Sphere(5), 2)
    data = maximum_data(structure, lambda z: np.einsum("ui,bij,uj->bu", z, matrices, z))
    solution = sos.solve(structure, data, backend="clarabel", workers=2)
    assert np.all(solution.optimal)
    np.testing.assert_allclose(solution["rho"], np.linalg.eigvalsh(matrices)[:, -1], rtol=1e-7)


def test_every_constraint_holds_at_the_optimum(tube):
    solution = sos.solve(tube, tube_data(tube, 1), backend="clarabel")
    assert solution.optimal
    assert np.max([solution.primal_residual, solution.dual_residual, solution.gap]) < 1e-6
    N, S, K = solution["N"], solution["S"], solution["K"]
    assert np.all(np.linalg.norm(K, axis=1) <= 0.5 + 1e-7)
    assert np.linalg.eigvalsh(S - K.T @ K)[0] > -1e-6
    np.testing.assert_allclose(N, N.T)


def test_a_batch_is_the_programs_one_by_one(tube):
    first, second = tube_data(tube, 1), tube_data(tube, 2)
    joined = tube.data(
        objective=first.objective,
        constraints={
            name: [np.stack([a, b]) for a, b in zip(arrays.values(), second.constraints[name].values(), strict=True)]
            for name, arrays in first.constraints.items()
        },
    )
    both = sos.solve(tube, joined, backend="clarabel")
    assert both.values.shape == (2, tube.size)
    for k, data in enumerate((first, second)):
        np.testing.assert_array_equal(both.values[k], sos.solve(tube, data, backend="clarabel").values)
