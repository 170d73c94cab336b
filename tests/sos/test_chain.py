"""Programs that start from their neighbours."""

import numpy as np
import pytest

from aerotube import sos
from aerotube.sos import Status
from tests.sos.programs import tube_data


def _joined(structure, each):
    """Programs as one batch."""
    return structure.data(
        objective=np.stack([data.objective for data in each]),
        constraints={
            name: [np.stack([data.constraints[name][key] for data in each]) for key in arrays]
            for name, arrays in each[0].constraints.items()
        },
    )


def _between(structure, first, last, share):
    """A program on the way from one to another."""

    def mixed(a, b):
        return (1.0 - share) * a + share * b

    return structure.data(
        objective=mixed(first.objective, last.objective),
        constraints={
            name: [mixed(array, last.constraints[name][key]) for key, array in arrays.items()]
            for name, arrays in first.constraints.items()
        },
    )


@pytest.fixture
def neighbours(tube):
    ends = [tube_data(tube, seed, limit=0.3) for seed in (0, 1)]
    return _joined(tube, [_between(tube, *ends, 0.01 * k) for k in range(9)])


def test_a_chain_finds_the_same_optima_in_fewer_iterations(tube, neighbours):
    afresh, chained = sos.solve(tube, neighbours), sos.solve(tube, neighbours, chain=9)
    assert chained.optimal.all()
    bounds = chained.certificate().bound
    assert np.all(bounds >= afresh.objective * (1.0 - 1e-6))
    np.testing.assert_allclose(bounds, afresh.certificate().bound, rtol=1e-6)
    assert np.sum(chained.iterations) < np.sum(afresh.iterations)


def test_chains_do_not_depend_on_workers(tube, neighbours):
    one, two = (sos.solve(tube, neighbours, chain=3, workers=workers) for workers in (1, 2))
    np.testing.assert_array_equal(one.values, two.values)
    np.testing.assert_array_equal(one.iterations, two.iterations)
    # A chain of one program is none.
    np.testing.assert_array_equal(sos.solve(tube, neighbours, chain=1).values, sos.solve(tube, neighbours).values)


def test_a_chain_begins_afresh(tube, neighbours):
    whole, part = sos.solve(tube, neighbours, chain=3), sos.solve(tube, neighbours)
    np.testing.assert_array_equal(whole.values[::3], part.values[::3])


@pytest.mark.parametrize("factor", [1e-4, 1e5])
def test_unlike_neighbours_do_no_harm(tube, factor):
    each = [tube_data(tube, seed, limit=0.3) for seed in range(4)]
    # The second cannot be satisfied, the third is of another size.
    broken = {name: list(arrays.values()) for name, arrays in each[1].constraints.items()}
    for name in broken:
        if name.startswith("limit"):
            broken[name][3] = np.asarray(-1.0)
    each[1] = tube.data(objective=each[1].objective, constraints=broken)
    each[2] = tube.data(
        objective=each[2].objective,
        constraints={
            name: [array * factor for array in arrays.values()] for name, arrays in each[2].constraints.items()
        },
    )
    data = _joined(tube, each)
    afresh, chained = sos.solve(tube, data), sos.solve(tube, data, chain=4)
    assert afresh.status.tolist() == chained.status.tolist()
    assert chained.status[1] == Status.INFEASIBLE
    good = chained.optimal
    np.testing.assert_allclose(chained.objective[good], afresh.objective[good], rtol=1e-6)


def test_a_chain_that_is_no_number_is_refused(tube, neighbours):
    with pytest.raises(ValueError, match="chain"):
        sos.solve(tube, neighbours, chain=0)
