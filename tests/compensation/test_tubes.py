"""Tubes whose true worst case is known in closed form, and what each certificate may say."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from aerotube.aircraft.base import STILL_AIR, Aircraft
from aerotube.aircraft.rigid_body import velocity_from_flow
from aerotube.compensation import (
    COUPLED,
    DECOUPLED,
    KINDS,
    SHARES,
    LinearLaw,
    SynthesisSettings,
    boundary,
    carried,
    flown_size,
    measure,
)
from aerotube.compensation import design as designed
from aerotube.compensation.covers import sum_around
from aerotube.compensation.sampled import FACTOR
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.sizes import certified_size
from aerotube.compensation.worst_points import Sampling, draw, support
from aerotube.dynamics import ErrorCoordinates, beat_set, flown_map, rk4
from aerotube.nominal import constant_controls
from aerotube.tube import DisturbanceBox
from tests.samples import BOX, HALF_WIDTHS, aircraft, table2

WIDTHS = np.array([4.0, 0.02, 0.03, 0.01, 0.02, 0.03, 0.03, 0.01])
DT = 0.1
POLYNOMIAL, SAMPLED, RIGOROUS = (SynthesisSettings(certificate=kind) for kind in KINDS[1:])


class Spinner(Aircraft):
    """Flies straight; its body rates grow by what a plain formula says, so that the worst end is known."""

    name = "spinner"
    control_lower = np.full(4, -1.0)
    control_upper = np.full(4, 1.0)

    def __init__(self, coupling=0.0, offset=0.0, bump=0.0, gusty=0.0):
        self.coupling, self.offset, self.bump, self.gusty = coupling, offset, bump, gusty

    def rates(self, state, control, parameters=None, wind=None):
        sigma = 1.0 if parameters is None else parameters[0]
        air = STILL_AIR if wind is None else wind
        p, q = state[7:9]
        zero = 0.0 * p
        turn = (control[2] + zero, control[0] + zero, control[3] + zero)
        off = (sigma - 1.0) * self.offset
        # the velocity is held in body axes and the attitude too, so that only the rates have an error of their own
        pitching = turn[1] + off * (1.0 - self.bump * (q * q) / WIDTHS[2] ** 2) + self.gusty * air[4]
        return (zero,) * 7 + (turn[0] + self.coupling * q, pitching, turn[2]) + (zero,) * 3


def spin(plane):
    state = np.array([*velocity_from_flow(150.0, 0.1, 0.0), 1.0, 0, 0, 0, 0, 0, 0, 0.0, 0.0, 2000.0])
    return constant_controls(plane, state, np.zeros(4), DT, 1)


def no_law(gain=0.0):
    """Pitch rate, roll rate and yaw rate fed back to what turns about their axes."""
    gains = np.zeros((1, 4, 8))
    gains[0, 0, 2] = gains[0, 2, 5] = gains[0, 3, 6] = gain
    return LinearLaw(gains, ErrorCoordinates("relative"))


def measured(plane, settings, law=None, change=0.2, **options):
    widths = ErrorCoordinates("relative").box(spin(plane).states[0], WIDTHS)
    metric = [np.diag(widths[list(part.errors)] ** -2.0)[None] for part in settings.parts]
    box = DisturbanceBox(WIDTHS, {"mass": change})
    return measure(plane, spin(plane), box, law or no_law(), metric, settings, **options)[0]


@pytest.mark.parametrize("settings", [SAMPLED, RIGOROUS])
def test_coupling_is_bounded_by_its_worst(settings):
    """p+ = p + dt c q: the largest of |z|^2 with 2 e z_p w_q + (e w_q)^2 added, |z| and |w| at most two."""
    tubes = measured(Spinner(coupling=3.0), settings, change=0.0)
    e = DT * 3.0
    worst = np.array([[4.0, (2.0 + 2.0 * e) ** 2]])
    assert (tubes.certificate == settings.certificate).all()
    np.testing.assert_allclose(tubes.polynomial_size, 4.0, rtol=1e-6)
    assert (tubes.size >= worst * (1 - 1e-9)).all()
    assert (tubes.size <= worst * (FACTOR * 1.001 if settings is SAMPLED else 1.004)).all()
    np.testing.assert_allclose(tubes.shares.sum(-1), tubes.size - tubes.polynomial_size, atol=1e-9)
    coupling = tubes.shares[0, :, SHARES.index("coupling")]
    assert coupling[0] == pytest.approx(0.0, abs=1e-6)
    assert coupling[1] == pytest.approx(worst[0, 1] - 4.0, rel=0.01)
    # the ellipsoid holds the ends of the worst points, where one half alone would leave them out
    ends = np.array([0.0, (2.0 + 2.0 * e) * WIDTHS[5], 0.0, 0.0])
    assert ends @ tubes.terminal_shape[0, 1] @ ends <= tubes.terminal_rho[0, 1] * (1 + 1e-9)


@pytest.mark.parametrize("settings", [SAMPLED, RIGOROUS])
def test_measurement_errors_and_gusts_are_bounded_by_their_worst(settings):
    """q+ = (1 + dt k) q + dt k v + dt g w in the unit of its width."""
    gain, share, gusty, rotation = -4.0, 0.5, 2.0, 0.04
    asked = replace(settings, measurement_error=share, gust_rotation=rotation)
    tubes = measured(Spinner(gusty=gusty), asked, no_law(gain), change=0.0)
    own = 1.0 + DT * gain  # largest of the other states, undamped, against that of q with all that is added
    noise, gust = DT * abs(gain) * share, DT * gusty * rotation / WIDTHS[2]
    z = np.linspace(0.0, 2.0, 20001)
    pitch = ((own * z + noise + gust) ** 2 + 4.0 - z**2).max()
    roll = max(((own * np.hypot(*z_) + np.hypot(noise, noise)) ** 2 + 4.0 - np.hypot(*z_) ** 2)
               for z_ in zip(z / np.sqrt(2), z / np.sqrt(2), strict=True))  # fmt: skip
    worst = np.array([[pitch, roll]])
    assert (tubes.certificate == settings.certificate).all()
    np.testing.assert_allclose(tubes.polynomial_size, 4.0, rtol=1e-6)
    assert (tubes.size >= worst * (1 - 1e-6)).all()
    # norms are added where the rigorous bound has no direction to tell
    assert (tubes.size <= worst * (FACTOR * 1.007 if settings is SAMPLED else 1.6)).all()
    shares = tubes.shares[0, 0]
    assert shares[SHARES.index("measurement")] > 0
    assert shares[SHARES.index("gusts")] > 0
    assert tubes.shares[0, 1, SHARES.index("gusts")] == pytest.approx(0.0, abs=1e-6)
    none = measured(Spinner(gusty=gusty), settings, no_law(gain), change=0.0)
    assert (none.size <= 4.0 * (FACTOR * 1.001 if settings is SAMPLED else 1.004)).all()


def test_where_the_largest_size_is_inside_the_ball_is_used():
    """q' = (s - 1) c (1 - b q^2): at the extremes of s far away for a small error, and not on the boundary."""
    offset, bump = 3.0, 0.24
    plane = Spinner(offset=offset, bump=bump)
    tubes = measured(plane, POLYNOMIAL)
    z = np.linspace(-2.0, 2.0, 4001)

    def worst(sigma):
        end = rk4(lambda x: [(sigma - 1.0) * offset / WIDTHS[2] * (1.0 - bump * x[0] ** 2)], [z], DT)[0]
        return end**2 + 4.0 - z**2

    found = np.stack([worst(1.0 / 1.2), worst(1.0 / 0.8)])
    inside, on_boundary = found.max(), found[:, [0, -1]].max()
    assert not tubes.boundary[0, 0]
    assert tubes.boundary[0, 1]
    assert inside > 1.3 * on_boundary
    # the polynomial of degree 4 through the values is not the map itself
    assert 0.98 * inside <= tubes.polynomial_size[0, 0] <= 1.2 * inside
    for settings in (SAMPLED, RIGOROUS):
        larger = measured(plane, settings)
        assert larger.size[0, 0] >= inside * (1 - 1e-6)
        assert not larger.boundary[0, 0]
    metric = [tubes.metric[:, index] for index in range(2)]
    box = DisturbanceBox(WIDTHS, {"mass": 0.2})
    alone = certified_size(plane, spin(plane), box, no_law(), metric, POLYNOMIAL)
    np.testing.assert_allclose(alone, tubes.polynomial_size, rtol=2e-4)


def test_the_laplacian_of_a_polynomial_is_bounded_from_below():
    nodes = boundary.nodes(4, 4)
    z = np.random.default_rng(0).normal(size=(4000, 4))
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    z *= np.random.default_rng(1).random((4000, 1)) ** 0.25

    def polynomial(x):
        return 3.0 * (x**2).sum(-1) + x[..., 0] ** 3 * x[..., 1] - 2.0 * x[..., 2] ** 4 + x[..., 3] ** 3

    laplacian = 24.0 + 6.0 * z[:, 0] * z[:, 1] - 24.0 * z[:, 2] ** 2 + 6.0 * z[:, 3]
    least = boundary.least_laplacian(polynomial(nodes), 4, 4)
    assert least <= laplacian.min()
    assert least > laplacian.min() - 12.0
    assert boundary.least_laplacian((nodes**2).sum(-1), 4, 4) == pytest.approx(8.0)
    assert boundary.least_laplacian(1.0 - (nodes**2).sum(-1), 4, 4) == pytest.approx(-8.0)


def test_an_ellipsoid_around_a_sum_holds_all_sums():
    random = np.random.default_rng(3)
    roots = random.normal(size=(3, 2, 3, 3)) * np.array([1.0, 0.1, 0.0])[:, None, None, None]
    roots[2, :, :, :1] = random.normal(size=(2, 3, 1))
    cover = np.linalg.inv(sum_around(roots @ np.swapaxes(roots, -1, -2)))
    z = random.normal(size=(3, 2, 500, 3))
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    points = (z @ np.swapaxes(roots, -1, -2)).sum(0)
    heights = np.einsum("bui,bij,buj->bu", points, cover, points)
    assert heights.max() <= 1 + 1e-12
    assert (heights.max(1) > 0.5).all()


@pytest.fixture(scope="module")
def f16():
    """A decoupled law on smooth tables and its tubes of each kind."""
    plane, nominal = aircraft("smooth"), table2(2, "smooth")
    made = designed(plane, nominal, BOX)
    tubes = {
        kind: measure(plane, nominal, BOX, made.law, made.metric, replace(made.settings, certificate=kind))[0]
        for kind in KINDS[1:]
    }
    return plane, nominal, made, tubes


def test_no_flight_of_the_set_leaves_a_sampled_or_rigorous_tube(f16):
    """Flights drawn by another seed, with the other half anywhere in its ellipsoid."""
    plane, nominal, made, tubes = f16
    balls = [
        (part.name, part.errors, np.sqrt(4.0) * np.eye(4) * made.law.coordinates.box(
            nominal.states[:-1], HALF_WIDTHS)[:, None, list(part.errors)])
        for part in DECOUPLED
    ]  # fmt: skip
    ranges = np.array([[1 / 1.05, 1 / 0.95]])
    over = beat_set(balls, plane.parameter_names, ranges)
    points = draw(over.balls, 4000, 99)
    for law, which in ((made.law, ("terminal", "size")), (None, ("nominal", "size_nominal"))):

        def flown(at, law=law):
            return flown_map(plane, nominal, range(2), made.law.coordinates, over, at, law)

        for index, part in enumerate(DECOUPLED):
            e = list(part.errors)
            metric = tubes["sampled"].metric[:, index]
            at = np.broadcast_to(points, (2, *points.shape))
            # besides the draws, points that the ends' linear fit puts farther out than the worst of them
            for _ in range(3):
                end = flown(at)[..., e]
                size = np.einsum("bui,bij,buj->bu", end, metric, end)
                fit = np.stack([np.linalg.lstsq(x, y, rcond=None)[0] for x, y in zip(at, end, strict=True)])
                worst = np.take_along_axis(end, np.argsort(-size, axis=1)[:, :20, None], axis=1)
                at = np.concatenate([at, support(over, worst @ metric @ np.swapaxes(fit, 1, 2))], axis=1)
            end = flown(at)[..., e]
            for kind in ("sampled", "rigorous"):
                tube = tubes[kind]
                shape, rho = (getattr(tube, f"{which[0]}_{name}")[:, index] for name in ("shape", "rho"))
                size = np.einsum("bui,bij,buj->bu", end, tube.metric[:, index], end).max(1)
                assert (size <= getattr(tube, which[1])[:, index]).all()
                assert (size > 0.75 * getattr(tube, which[1])[:, index]).all()
                assert (np.einsum("bui,bij,buj->bu", end, shape, end) <= rho[:, None]).all()
    assert (tubes["polynomial only"].size < tubes["sampled"].size).all()


def test_kinds_are_never_overstated(f16):
    plane, nominal, made, tubes = f16
    for kind, tube in tubes.items():
        assert (tube.certificate == kind).all()
        assert (tube.certificate_nominal == kind).all()
        assert tube.messages == ()
    assert np.isnan(tubes["polynomial only"].shares).all()

    class Unknown:
        coordinates = made.law.coordinates
        increments = made.law.increments

    asked = replace(made.settings, certificate="rigorous")
    lower, _ = measure(plane, nominal, BOX, Unknown(), made.metric, asked)
    assert (lower.certificate == "sampled").all()
    assert len(lower.messages) == 8
    assert "beat 0, longitudinal: the tube is not rigorous" in lower.messages[0]
    np.testing.assert_allclose(lower.size, tubes["sampled"].size, rtol=1e-9)

    class Wild(Unknown):
        def increments(self, beats, error):
            near = np.abs(error / HALF_WIDTHS).max(-1, keepdims=True) < 1.99
            return np.where(near, made.law.increments(beats, error), np.nan)

    wild = Wild()
    least, _ = measure(plane, nominal, BOX, wild, made.metric, replace(made.settings, certificate="sampled"))
    assert np.isin(least.certificate, ("none", "solver's word", "polynomial only")).all()


def test_a_decoupled_law_has_a_coupled_tube(f16):
    plane, nominal, made, tubes = f16
    whole, evidence = measure(
        plane, nominal, BOX, made.law, made.metric, replace(made.settings, certificate="polynomial only"), parts=COUPLED
    )
    assert whole.size.shape == (2, 1)
    assert len(evidence) == 1
    # the ball of both halves holds each, and its size is the sum of theirs
    assert (whole.size[:, 0] >= tubes["polynomial only"].size.max(1)).all()
    assert (whole.metric[:, 0, :4, 4:] == 0).all()


def test_a_carried_coupling_is_the_worst_of_the_linearised_map():
    """The two points of the other half's ellipsoid, against a dense sample of it; the law withstands both."""
    plane, nominal = aircraft("smooth"), table2(2, "smooth")
    law = designed(plane, nominal, BOX, SynthesisSettings(coupling="carried"))
    dropped = designed(plane, nominal, BOX, SynthesisSettings(coupling="dropped"))
    assert law.feasible.all()
    assert np.abs(law.law.gains - dropped.law.gains).max() > 0
    # more is withstood in the program, so its optimum is no less
    assert (law.bound >= dropped.bound * (1 - 1e-5)).all()
    task = SimpleNamespace(
        settings=law.settings,
        ground=SimpleNamespace(
            linear=law.linearisation,
            parts=[
                SimpleNamespace(
                    metric=law.metric[index],
                    initial=initial_ellipsoid(BOX, law.law.coordinates, nominal.states[:-1], part),
                )
                for index, part in enumerate(DECOUPLED)
            ],
        ),
    )
    z = np.random.default_rng(0).normal(size=(3000, 4))
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    for index, part in enumerate(DECOUPLED):
        other = list(DECOUPLED[1 - index].errors)
        worst = carried.others_at_worst(task, index, np.arange(2))
        assert (worst[:, :, list(part.errors)] == 0).all()
        A, form = law.linearisation.A[:2][:, list(part.errors)][:, :, other], law.metric[index]

        def size(points, A=A, form=form):
            ends = points @ np.swapaxes(A, 1, 2)
            return np.sum((ends @ form) * ends, axis=-1)

        whitening = task.ground.parts[1 - index].initial.whitening
        sampled = size(z @ np.swapaxes(whitening, 1, 2)).max(1)
        assert (size(worst[..., other]) >= sampled[:, None] * (1 - 1e-9)).all()
        inside = np.linalg.norm(worst[..., other] @ np.swapaxes(np.linalg.inv(whitening), 1, 2), axis=-1)
        np.testing.assert_allclose(inside, 1.0)


def test_linear_tables_may_be_rigorous_too():
    plane, nominal = aircraft(), table2(1)
    made = designed(plane, nominal, BOX)
    tubes = {
        kind: measure(plane, nominal, BOX, made.law, made.metric, replace(made.settings, certificate=kind))[0]
        for kind in ("sampled", "rigorous")
    }
    assert np.isin(tubes["rigorous"].certificate, ("rigorous", "sampled")).all()
    kinked = tubes["rigorous"].certificate == "rigorous"
    assert (tubes["rigorous"].size * FACTOR >= tubes["sampled"].size)[kinked].all()


def test_samples_are_worth_what_they_say():
    sampling = Sampling(400, 0.999, 0)
    assert (1.0 - sampling.share) ** 400 == pytest.approx(0.001)
    random = np.random.default_rng(5)
    # the largest of 400 is exceeded by a share of more than `share` in one case of a thousand
    rates = 1.0 - random.random((20000, 400)).max(1)
    assert np.mean(rates > sampling.share) < 0.003
    points = draw((4, 1), 4000, 1)
    assert (np.linalg.norm(points[:, :4], axis=1) <= 1 + 1e-12).all()
    assert np.mean(np.linalg.norm(points[:, :4], axis=1) > 1 - 1e-9) == pytest.approx(0.5, abs=0.05)
    assert np.mean(np.abs(points[:, 4]) == 1.0) == pytest.approx(0.5, abs=0.05)
    over = beat_set([("all", tuple(range(8)), np.eye(8)[None])], ("inverse_mass",), np.array([[0.9, 1.1]]))
    direction = random.normal(size=(1, 1, 9))
    best = support(over, direction)
    assert (best @ direction[0, 0] >= draw(over.balls, 500, 2) @ direction[0, 0]).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [({"certificate": "sure"}, "certificate"), ({"samples": 3}, "samples"), ({"confidence": 1.0}, "confidence"),
     ({"gust": -1.0}, "gust")],
)  # fmt: skip
def test_settings_out_of_range_are_named(change, words):
    with pytest.raises(Exception, match=words):
        SynthesisSettings(**change)


def test_in_flight_the_sampled_size_is_that_of_the_tube():
    settings, beats = replace(SAMPLED, noise_weight=1.0, measurement_error=1.0), range(2, 6)
    nominal = table2(8)
    made = designed(aircraft(), nominal, BOX, settings, beats=beats)
    tubes, _ = measure(aircraft(), nominal, BOX, made.law, made.metric, settings, beats=beats)
    size, kind = flown_size(aircraft(), nominal, BOX, made.law, made.metric, settings, beats=beats, workers=2)
    assert (kind == "sampled").all()
    np.testing.assert_allclose(np.maximum(size, tubes.polynomial_size), tubes.size, rtol=1e-6)


def test_in_flight_a_polynomial_stands_in_where_a_sample_does_not_come_home():
    """Pitch rates beyond what the nodes of the polynomial reach break the aircraft, and only samples meet them."""
    plane = Fragile()
    metric = [np.eye(4)[None], np.eye(4)[None]]
    size, kind = flown_size(plane, spin(plane), DisturbanceBox(WIDTHS), no_law(), metric, SAMPLED)
    assert kind.tolist() == [["polynomial only", "polynomial only"]]
    assert np.isfinite(size).all()


class Fragile(Spinner):
    """Not finite where pitch and roll rate are both away from zero: where the halves' errors meet."""

    def rates(self, state, control, parameters=None, wind=None):
        p, q = state[7:9]
        made = super().rates(state, control, parameters, wind)
        broken = np.where(np.abs(p * q) > 1e-9, np.nan, 0.0)
        return (*made[:7], made[7] + broken, made[8] + broken, *made[9:])
