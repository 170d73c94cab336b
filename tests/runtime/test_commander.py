"""One beat: the same numbers as the simulation's, limits that always hold, and what is not believed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from aerotube.compensation import SynthesisSettings
from aerotube.dynamics import ErrorCoordinates
from aerotube.runtime.commander import Beat, Commander, Source
from aerotube.runtime.kernels import clamp, increments
from aerotube.runtime.law import Form, Laws
from aerotube.runtime.messages import Rung
from tests.samples import HALF_WIDTHS, aircraft, table2

NOMINAL = table2(4)
FORM = Form.of(SynthesisSettings())


def commander(kind="relative"):
    return Commander(aircraft(), ErrorCoordinates(kind), NOMINAL.dt, None, FORM, 20.0 * HALF_WIDTHS)


def beat(gains, number=0):
    law = Laws.linear(FORM, gains[None])[0]
    return Beat(NOMINAL.states[number], NOMINAL.controls[number], law, Rung.PLANNED, NOMINAL.states[number + 1])


def test_command_is_the_law_realised():
    random = np.random.default_rng(4)
    gains = random.uniform(-1, 1, (4, 8)) * np.array([0.02, 2e4, 0.05, 0.05])[:, None]
    coordinates, made = ErrorCoordinates(), commander()
    for _ in range(20):
        state = coordinates.retract(NOMINAL.states[0], random.uniform(-1, 1, 8) * HALF_WIDTHS)
        found = made.command(0, state, beat(gains))
        error = coordinates.difference(state, NOMINAL.states[0])
        assert found.control == pytest.approx(
            aircraft().realise(state, NOMINAL.controls[0], gains @ error), rel=1e-10, abs=1e-12
        )
        assert found.source == Source.MEASURED
        assert found.rung == Rung.PLANNED


@pytest.mark.parametrize(
    ("degree", "algorithm"), [(1, "decoupled"), (2, "decoupled"), (3, "decoupled"), (2, "coupled")]
)
@pytest.mark.parametrize("saturates", [False, True])
def test_compiled_laws_are_those_that_are_certified(degree, algorithm, saturates):
    random = np.random.default_rng(degree)
    form = Form.of(SynthesisSettings(law_degree=degree, algorithm=algorithm))
    laws = Laws.none(form, 1)
    scale = np.prod(HALF_WIDTHS ** -form.exponents.astype(float), axis=1)
    laws.coefficients[0] = random.uniform(-1, 1, (4, form.monomials)) * scale
    for errors in form.parts if degree > 1 else ():
        block = np.ix_([0], errors, errors)
        laws.reach[block] = np.diag(1.0 / HALF_WIDTHS[list(errors)])
    if saturates:
        laws.room[0] = [-1.5, 1.0]
    for share in random.uniform(-2, 2, (40, 8)):
        state = ErrorCoordinates().retract(NOMINAL.states[0], share * HALF_WIDTHS)
        law = laws[0]
        error, found = increments(
            law.coefficients, law.room, law.reach, form.factors, form.part_of, state, NOMINAL.states[0], True
        )
        expected = laws.batch(form, ErrorCoordinates()).increments(np.zeros(1, int), error[None, None])[0, 0]
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert not saturates or (np.abs(found - [-0.25] * 4) <= 1.25).all()


wild = hnp.arrays(float, (4, 8), elements=st.floats(allow_nan=True, allow_infinity=True))


@settings(deadline=None, max_examples=60)
@given(wild, hnp.arrays(float, 8, elements=st.floats(-3.0, 3.0)))
def test_no_law_and_no_error_gets_a_command_out_of_its_limits(gains, share):
    state = ErrorCoordinates("euler").retract(NOMINAL.states[0], share * HALF_WIDTHS)
    with np.errstate(all="ignore"):
        found = commander().command(0, state, beat(np.ascontiguousarray(gains)))
    assert (found.control >= aircraft().control_lower).all()
    assert (found.control <= aircraft().control_upper).all()


def test_clamp_says_where_it_acts():
    low, high, nominal = np.array([-1.0, 0, -1, -1]), np.ones(4), np.array([0.0, 1.0, 0.0, 0.0])
    wanted, increment = np.array([5.0, 3.0, 0.5, np.nan]), np.array([5.0, 2.0, 0.5, 0.0])
    control, held = clamp(wanted, nominal, increment, low, high)
    assert control.tolist() == [1.0, 1.0, 0.5, 0.0]
    # the second stands on its limit already in the nominal: the clamp takes nothing from it that was there
    assert held.tolist() == [True, False, False, False]


def test_what_is_not_believed():
    made, law = commander(), beat(np.zeros((4, 8)))
    good = NOMINAL.states[0]
    assert made.believes(good, law)
    for place, value in ((0, np.nan), (9, np.inf), (3, 5.0), (0, 1e6), (7, 9.0)):
        bad = good.copy()
        bad[place] = value
        assert not made.believes(bad, law)


def test_three_unlikely_measurements_in_a_row_are_believed():
    made, law = commander(), beat(np.zeros((4, 8)))
    far = ErrorCoordinates("euler").retract(NOMINAL.states[0], 25.0 * HALF_WIDTHS * np.eye(8)[4])
    assert [made.believes(far, law) for _ in range(3)] == [False, False, True]


def test_without_measurements_the_model_carries_on_and_then_the_nominal_flies():
    made = commander()
    gains = np.zeros((4, 8))
    gains[0, 1] = 0.5
    state = ErrorCoordinates("euler").retract(NOMINAL.states[0], 0.5 * HALF_WIDTHS)
    first = made.command(0, state, beat(gains))
    made.after(0, beat(gains), first.control)
    ahead = aircraft().compiled_step()(
        state[None], first.control[None], np.ones((1, 1)), np.zeros((1, 6)), NOMINAL.dt, 1
    )[0]
    second = made.command(1, None, beat(gains, 1))
    assert second.source == Source.PREDICTED
    assert second.error == pytest.approx(ErrorCoordinates().difference(ahead, NOMINAL.states[1]), abs=1e-12)
    for _ in range(made.stale + 1):
        made.after(1, beat(gains, 1), second.control)
        last = made.command(1, None, beat(gains, 1))
    assert last.source == Source.NONE
    assert last.rung == Rung.NOMINAL
    assert last.control == pytest.approx(NOMINAL.controls[1])


def test_rehearsal_changes_nothing():
    one, other = commander(), commander()
    gains = np.full((4, 8), 1e-3)
    state = ErrorCoordinates("euler").retract(NOMINAL.states[0], 0.5 * HALF_WIDTHS)
    for made in (one, other):
        made.after(0, beat(gains), made.command(0, state, beat(gains)).control)
    one.rehearse(1, replace(beat(gains, 1), rung=Rung.LQR))
    assert (
        one.command(1, None, beat(gains, 1)).control.tolist() == other.command(1, None, beat(gains, 1)).control.tolist()
    )
