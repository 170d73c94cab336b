"""Deliberately wrong tubes: the search on the true map, or the certificate computed again, must reject every one."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from aerotube.aircraft import F16
from aerotube.compensation import LinearLaw, SynthesisSettings, synthesise
from aerotube.nominal import constant_controls
from aerotube.verify import falsify, recheck
from tests.samples import BOX, TABLE2_CONTROL, aircraft, table2, table2_state

BEATS = 2
KINDS = ("polynomial only", "sampled")
LONGITUDINAL, LATERAL = 0, 1
SIZE, ELLIPSOID = 0, 1


@lru_cache
def made(kind, **settings):
    return synthesise(aircraft(), table2(BEATS), BOX, SynthesisSettings(certificate=kind, **settings))


def attack(tubes):
    return falsify(aircraft(), table2(BEATS), BOX, tubes, samples=300, ascents=12)


def checked(tubes):
    return recheck(aircraft(), table2(BEATS), BOX, tubes)


def with_gains(kind, change):
    right = made(kind)
    return replace(right, law=LinearLaw(change(right.law.gains.copy()), right.law.coordinates))


def with_tubes(kind, **change):
    right = made(kind)
    return replace(right, tubes=replace(right.tubes, **change))


@pytest.mark.parametrize("kind", KINDS)
def test_right_tubes_are_not_rejected(kind):
    """What they promise holds; polynomials do not hold for the ellipsoids they are drawn as."""
    found = attack(made(kind))
    assert (found.ratio[..., SIZE] < 1 + 1e-3).all()
    assert checked(made(kind)).all()
    if kind == "sampled":
        assert not found.broken.any()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("part", [LONGITUDINAL, LATERAL])
@pytest.mark.parametrize("form", ["size", "terminal_rho"])
def test_bounds_shrunk_by_more_than_their_slack(kind, part, form):
    right = attack(made(kind)).ratio
    name = SIZE if form == "size" else ELLIPSOID
    # what was found against the right tube says how much slack it has at most
    shrunk = getattr(made(kind).tubes, form).copy()
    shrunk[:, part] *= right[:, part, name] * (1 - 5e-3)
    wrong = attack(with_tubes(kind, **{form: shrunk}))
    assert wrong.broken[:, part, name].all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [1e-6, 1e-3, 0.1])
def test_sizes_below_their_certificates(kind, share):
    """Whatever was added beyond the polynomials: below the polynomials' own size no certificate bears the tube out."""
    tubes = made(kind).tubes
    assert not checked(with_tubes(kind, size=tubes.polynomial_size * (1 - share))).any()
    assert checked(with_tubes(kind, size=tubes.polynomial_size)).all()


PERTURBED = {
    "none": lambda gains: 0 * gains,
    "half": lambda gains: 0.5 * gains,
    "more": lambda gains: 1.5 * gains,
    "double": lambda gains: 2 * gains,
    "reversed": lambda gains: -gains,
    "one state reversed in each half": lambda gains: gains * np.where(np.isin(np.arange(8), (1, 5)), -1, 1),
    "by a fifth at random": lambda gains: gains * (1 + 0.2 * np.random.default_rng(1).uniform(-1, 1, gains.shape)),
    "by half at random": lambda gains: gains * (1 + 0.5 * np.random.default_rng(2).uniform(-1, 1, gains.shape)),
    "another beat's": lambda gains: np.roll(gains, 1, axis=0),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", PERTURBED.values(), ids=PERTURBED)
def test_perturbed_gains(kind, change):
    wrong = with_gains(kind, change)
    assert attack(wrong).broken.any(axis=-1).all()
    if kind == "polynomial only":
        assert not checked(wrong).any()


@pytest.mark.parametrize("kind", KINDS)
def test_aileron_and_rudder_exchanged(kind):
    wrong = with_gains(kind, lambda gains: gains[:, [0, 1, 3, 2]])
    assert attack(wrong).broken[:, LATERAL].all()
    assert not checked(wrong)[:, LATERAL].any()


def another_beat_later():
    """The law of the same aircraft for the manoeuvre a second on."""
    later = constant_controls(aircraft(), table2_state(), TABLE2_CONTROL, 0.05, 22)
    cut = type(later)(later.dt, later.states[20:], later.controls[20:])
    return synthesise(aircraft(), cut, BOX).law


OTHERS = {
    "centre of gravity aft": lambda: synthesise(F16(xcg=0.4), table2(BEATS), BOX).law,
    "centre of gravity forward": lambda: synthesise(F16(xcg=0.22), table2(BEATS), BOX).law,
    "a second later": another_beat_later,
    "for noise": lambda: (
        synthesise(
            aircraft(),
            table2(BEATS),
            BOX,
            SynthesisSettings(noise_weight=1.0, measurement_error=1.0, control_weight=1e-2),
        ).law
    ),
    "of worst case": lambda: synthesise(aircraft(), table2(BEATS), BOX, SynthesisSettings(size="worst-case")).law,
}


@lru_cache
def other(name):
    return OTHERS[name]()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", OTHERS)
def test_the_law_of_another(kind, name):
    wrong = replace(made(kind), law=other(name))
    assert attack(wrong).broken.any(axis=-1).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("xcg", [0.22, 0.4])
def test_the_tubes_of_another_aircraft(kind, xcg):
    """Laws and tubes belong together, the aircraft that flies is another."""
    found = falsify(F16(xcg=xcg), table2(BEATS), BOX, made(kind), samples=300, ascents=12)
    assert found.broken.any(axis=-1).all()


def test_tubes_without_coupling_that_claim_it():
    """What holds for polynomials of one half only is passed off as holding whatever the other half does."""
    alone = with_tubes("polynomial only", certificate=made("sampled").tubes.certificate)
    found = attack(alone)
    assert found.broken[:, LATERAL].all()
    assert found.broken[:, LONGITUDINAL].all()
    # it is the other half that does it
    assert np.abs(found.error[:, LATERAL, ELLIPSOID, :4]).max(axis=-1).all()


@pytest.mark.parametrize("change", [{"measurement_error": 0.5}, {"gust": 3.0}, {"gust_rotation": 0.02}])
def test_tubes_that_claim_to_withstand_what_they_were_not_made_for(change):
    right = made("sampled")
    claimed = replace(right, settings=replace(right.settings, **change))
    assert attack(claimed).broken.any(axis=-1).all()


def test_tubes_for_a_smaller_range_of_masses():
    """Mass enters the longitudinal half; the lateral one has slack for it."""
    wider = type(BOX)(BOX.half_widths, {"mass": 0.15})
    found = falsify(aircraft(), table2(BEATS), wider, made("sampled"), samples=300, ascents=12)
    assert found.broken[:, LONGITUDINAL].any(axis=-1).all()


def test_tubes_for_a_smaller_set_of_errors():
    tubes = made("sampled").tubes
    wrong = with_tubes("sampled", initial_rho=1.1 * tubes.initial_rho)
    assert attack(wrong).broken.any(axis=-1).all()
    assert not checked(replace(wrong, tubes=replace(wrong.tubes, size=tubes.polynomial_size))).any()
