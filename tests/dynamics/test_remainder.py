"""Enclosures of the error map hold the true map, and what follows from them for a tube does."""

from itertools import pairwise

import numpy as np
import pytest

from aerotube.dynamics import (
    ErrorCoordinates,
    beat_set,
    enclose_error_map,
    error_map,
    excess,
    graded_sizes,
    linear_law,
    size_samples,
    step,
    taylor_map,
)
from aerotube.errors import ComputationError, InputError
from aerotube.tube import ellipsoid, parameter_ranges
from tests import samples

BEATS = np.array([0, 3])
RELATIVE = ErrorCoordinates("relative")
HALVES = (("longitudinal", (0, 1, 2, 3)), ("lateral", (4, 5, 6, 7)))
# elevator against pitch rate and attack, thrust against airspeed, aileron against roll, rudder against yaw rate
GAINS = np.zeros((2, 4, 8))
GAINS[:, 0, [1, 2]] = 0.4, 0.3
GAINS[:, 1, 0] = -500.0
GAINS[:, 2, [5, 7]] = 0.15, 0.2
GAINS[:, 3, 6] = 0.4
METRIC = np.array([np.diag(samples.HALF_WIDTHS[list(errors)] ** -2.0) for _, errors in HALVES])


def whole_set(interpolation="smooth", scale=1.0, change=0.05, split=True, coordinates=RELATIVE, **boxes):
    """Ellipsoids of least volume around the disturbance box, one a half or one for all."""
    aircraft, nominal = samples.aircraft(interpolation), samples.table2(5, interpolation)
    widths = scale * coordinates.box(nominal.states[BEATS], samples.HALF_WIDTHS)
    parts = HALVES if split else (("all", tuple(range(8))),)
    maps = [
        (name, errors, ellipsoid.whitening(*ellipsoid.least_volume_around_box(widths[:, errors])))
        for name, errors in parts
    ]
    return beat_set(maps, aircraft.parameter_names, parameter_ranges(aircraft, {"mass": change}), **boxes)


def enclosed(over, law=None, order=3, interpolation="smooth", coordinates=RELATIVE):
    aircraft, nominal = samples.aircraft(interpolation), samples.table2(5, interpolation)
    return enclose_error_map(aircraft, nominal, BEATS, coordinates, over, law, order)


def points_of(over, count, seed=0):
    random = np.random.default_rng(seed)
    parts = []
    for size in over.balls:
        x = random.standard_normal((len(BEATS), count, size))
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        parts.append(x * np.where(random.random((len(BEATS), count, 1)) < 0.8, 1.0, random.random((1, count, 1))))
    return np.concatenate(parts, axis=-1)


def truth(over, z, gains=None, interpolation="smooth", coordinates=RELATIVE):
    """The map in floating point, from the arrays of the set."""
    aircraft, nominal = samples.aircraft(interpolation), samples.table2(5, interpolation)

    def image(matrix):
        return np.einsum("bik,buk->bui", matrix, z)

    error = image(over.error)
    seen = error if over.measurement is None else error + image(over.measurement)
    increment = None if gains is None else np.einsum("bmi,bui->bum", gains, seen)
    parameters = over.parameters + z @ over.parameter_reach.T
    if over.wind is None:
        return error_map(aircraft, nominal, BEATS, coordinates, error, increment, parameters)
    end = step(
        aircraft,
        coordinates.retract(nominal.states[BEATS][:, None], error),
        nominal.controls[BEATS][:, None],
        nominal.dt,
        parameters=parameters,
        wind=image(over.wind),
        increment=increment,
    )
    return coordinates.difference(end, nominal.states[BEATS + 1][:, None])


@pytest.mark.parametrize(
    ("interpolation", "order", "split", "gains"),
    [("smooth", 3, True, GAINS), ("smooth", 4, False, GAINS), ("smooth", 3, False, None), ("linear", 2, True, GAINS)],
)
def test_the_true_map_stays_within_the_enclosure(interpolation, order, split, gains):
    over = whole_set(interpolation, split=split)
    found = enclosed(over, None if gains is None else linear_law(gains), order, interpolation)
    z = points_of(over, 3000)
    apart = np.abs(truth(over, z, gains, interpolation) - found(z))
    assert np.all(apart <= found.remainder[:, None] + 1e-12)
    if interpolation == "smooth":
        # small beside the set itself, and not a wild overestimate
        reach = np.linalg.norm(over.error, axis=-1)
        assert np.all(found.remainder < 0.06 * reach)
        assert np.all(apart.max(1) > found.remainder / 1000.0)


def test_euler_coordinates_measurement_errors_and_wind():
    euler = ErrorCoordinates("euler")
    boxes = {"measurement": 0.3 * samples.HALF_WIDTHS, "wind": [3.0, 0.0, 2.0, 0.0, 0.01, 0.0]}
    over = whole_set(scale=0.7, coordinates=euler, **boxes)
    assert over.balls == (4, 4, 1) + 11 * (1,)
    found = enclosed(over, linear_law(GAINS), 2, coordinates=euler)
    z = points_of(over, 2000)
    apart = np.abs(truth(over, z, GAINS, coordinates=euler) - found(z))
    assert np.all(apart <= found.remainder[:, None] + 1e-12)
    share = excess(found, np.stack([METRIC[0]] * 2), "longitudinal", (0, 1, 2, 3), ("lateral",), ("inverse_mass",))
    assert np.all(share.disturbances > 0.0)


def test_the_polynomial_is_the_taylor_polynomial():
    aircraft, nominal = samples.aircraft("smooth"), samples.table2(5, "smooth")
    widths = RELATIVE.box(nominal.states[BEATS], samples.HALF_WIDTHS)
    over = beat_set(
        [(str(i), (i,), widths[:, [i], None]) for i in range(8)],
        aircraft.parameter_names,
        parameter_ranges(aircraft, {"mass": 0.05}),
    )
    found = enclosed(over)
    expected = taylor_map(
        aircraft, nominal, BEATS, RELATIVE, order=3, increments=(), parameters=(0,), at=over.parameters
    )
    reach = np.concatenate([widths, np.full((2, 1), over.parameter_reach[0, -1])], axis=1)
    scaled = expected.coefficients * np.prod(reach[:, None] ** expected.space.exponents, axis=-1)[:, None]
    assert found.coefficients == pytest.approx(scaled, rel=1e-9, abs=1e-13)


@pytest.mark.parametrize("order", [2, 3])
def test_halving_the_set_divides_the_remainder(order):
    """By two to the order plus one; the range of mass is halved too."""
    remainders = [
        enclosed(whole_set(scale=scale, change=0.05 * scale), linear_law(GAINS), order).remainder
        for scale in (0.4, 0.2, 0.1)
    ]
    for wide, narrow in pairwise(remainders):
        assert np.all(wide / narrow > 0.8 * 2 ** (order + 1))


def test_lower_orders_by_truncation():
    over = whole_set()
    found = enclosed(over, linear_law(GAINS), 4)
    cut = found.truncated(2)
    z = points_of(over, 1500)
    assert cut.space.order == 2
    assert np.all(np.abs(truth(over, z, GAINS) - cut(z)) <= cut.remainder[:, None] + 1e-12)
    assert np.all(cut.remainder > found.remainder)


def test_a_polynomial_law():
    """The law is any polynomial of the measured error: here one of second degree."""

    def law(error):
        zero = 0.0 * error[0]
        return [0.4 * error[2] + 3.0 * error[1] * error[1], -400.0 * error[0], 0.2 * error[5] * error[3], zero]

    over, aircraft, nominal = whole_set(), samples.aircraft("smooth"), samples.table2(5, "smooth")
    found = enclosed(over, law)
    z = points_of(over, 1500)
    error = np.einsum("bik,buk->bui", over.error, z)
    increment = np.stack(law(np.moveaxis(error, -1, 0)), axis=-1)
    parameters = over.parameters + z @ over.parameter_reach.T
    true = error_map(aircraft, nominal, BEATS, RELATIVE, error, increment, parameters)
    apart = np.abs(true - found(z))
    assert np.all(apart <= found.remainder[:, None] + 1e-12)
    assert np.any(apart > found.remainder[:, None] / 50.0)


@pytest.mark.parametrize("half", [0, 1])
def test_shares_cover_what_a_half_leaves_out(half):
    """Another route: the true map less the half's own polynomial, at extremes of the mass and inside."""
    over = whole_set()
    found = enclosed(over, linear_law(GAINS), 4)
    (name, errors), (other, _) = HALVES[half], HALVES[1 - half]
    metric = np.stack([METRIC[half]] * 2)
    share = excess(found, metric, name, errors, (other,), ("inverse_mass",))
    z = points_of(over, 4000)
    own = z.copy()
    own[..., over.columns(other)] = 0.0
    away = (truth(over, z, GAINS) - found(own))[..., list(errors)]
    worst = np.sqrt(np.einsum("bui,ij,buj->bu", away, METRIC[half], away).max(1))
    assert np.all(worst <= share.remainder + share.coupling)
    assert np.all(worst > share.remainder)
    assert np.all(share.coupling < 4.0 * worst)

    # not affine in the parameter: its middle against the mean of its extremes
    at = [np.concatenate([own[..., :8], np.full_like(own[..., 8:], value)], axis=-1) for value in (-1.0, 0.0, 1.0)]
    low, middle, high = (truth(over, each, GAINS)[..., list(errors)] for each in at)
    bent = middle - 0.5 * (low + high)
    worst = np.sqrt(np.einsum("bui,ij,buj->bu", bent, METRIC[half], bent).max(1))
    assert np.all(worst <= share.parameters + 2.0 * share.remainder)
    assert np.all(share.parameters < 3.0 * worst + 1e-4)

    # what coupling adds to the size itself, by the polynomials with the other half and without
    both, alone = (found(at)[..., list(errors)] for at in (z, own))
    added = np.einsum("bui,ij,buj->bu", both, METRIC[half], both) - np.einsum(
        "bui,ij,buj->bu", alone, METRIC[half], alone
    )
    assert np.all(added.max(1) <= share.coupling_size)
    assert np.all(share.coupling_size < 4.0 * added.max(1))

    # the bound that follows for the whole set, from a bound of the half's own polynomial
    true = truth(over, z, GAINS)[..., list(errors)]
    largest = np.einsum("bui,ij,buj->bu", alone, METRIC[half], alone).max(1)
    sizes = np.einsum("bui,ij,buj->bu", true, METRIC[half], true).max(1)
    assert np.all(sizes <= share.bound(graded_sizes(found, metric, errors).sum(1) ** 2))
    assert np.all(share.bound(largest) > largest)


def test_control_share_is_the_bend_of_the_increments_effect():
    """Second route: r(z) + B K z against the map with the law, mass at its middle."""
    over = whole_set(change=0.0, split=False)
    with_law, without = enclosed(over, linear_law(GAINS), 4), enclosed(over, None, 4)
    metric = np.stack([np.diag(samples.HALF_WIDTHS**-2.0)] * 2)
    share = excess(with_law, metric, "all", range(8), without_law=without)
    z = points_of(over, 3000)
    tiny = 1e-5 * z
    slope = (truth(over, tiny, GAINS) - truth(over, tiny)) / 1e-5
    away = truth(over, z, GAINS) - truth(over, z) - slope
    worst = np.sqrt(np.einsum("bui,ij,buj->bu", away, metric[0], away).max(1))
    assert np.all(worst <= share.control + 2.0 * share.remainder + 1e-4)
    assert np.all(worst > 0.1 * share.control)
    assert np.all(share.coupling == 0.0)


def test_samples_of_the_size():
    over = whole_set()
    found = enclosed(over, linear_law(GAINS), 3)
    name, errors = HALVES[1]
    metric = np.stack([METRIC[1]] * 2)
    nodes = np.random.default_rng(1).standard_normal((60, 4))
    nodes /= np.linalg.norm(nodes, axis=1, keepdims=True)
    z = np.zeros((2, 2, 60, 9))
    z[..., over.columns(name)] = nodes
    z[:, 0, :, 8], z[:, 1, :, 8] = -1.0, 1.0
    end = found(z.reshape(2, 120, 9)).reshape(2, 2, 60, 8)[..., list(errors)]
    whole = np.einsum("bkui,ij,bkuj->bku", end, METRIC[1], end)
    everything = size_samples(found, metric, name, errors, ("inverse_mass",), nodes, degree=6)
    assert everything.values == pytest.approx(whole, rel=1e-9)
    assert np.all(np.abs(everything.values - whole) <= everything.rounding[:, None, None])
    assert np.all(everything.left_out == 0.0)
    lower = size_samples(found, metric, name, errors, ("inverse_mass",), nodes, degree=4)
    assert np.all(np.abs(lower.values - whole) <= lower.left_out[:, None, None])
    assert np.all(lower.left_out < 0.05 * whole.max((1, 2)))
    # of degree four along every ray: the fifth difference vanishes
    along = [size_samples(found, metric, name, errors, ("inverse_mass",), t * nodes).values for t in np.arange(6) / 5]
    assert np.abs(np.diff(along, n=5, axis=0)).max() <= 1e-10 * whole.max()
    assert np.abs(np.diff(along, n=4, axis=0)).max() > 1e-6 * whole.max()


def test_refusals():
    with pytest.raises(ComputationError, match="set of errors is too large"):
        enclosed(whole_set(scale=20.0))
    over = whole_set()
    found = enclosed(over, order=1)
    with pytest.raises(InputError, match="no ball 'sideways'"):
        over.columns("sideways")
    with pytest.raises(InputError, match="positive definite"):
        excess(found, -np.stack([METRIC[0]] * 2), "longitudinal", (0, 1, 2, 3))
    nearly = np.stack([METRIC[0]] * 2)
    nearly[:, 2, 3] = nearly[:, 3, 2] = np.sqrt(nearly[:, 2, 2] * nearly[:, 3, 3]) * (1.0 - 1e-13)
    with pytest.raises(InputError, match="singular"):
        excess(found, nearly, "longitudinal", (0, 1, 2, 3))
