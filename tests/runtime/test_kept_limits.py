"""Kept laws keep the limits that were asked for, on the nominal on which they would be kept."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from aerotube.compensation import SynthesisSettings
from aerotube.compensation.groundwork import groundwork
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.nominal import Nominal, constant_controls
from aerotube.runtime import task as tasks
from aerotube.runtime.messages import Rung
from aerotube.runtime.task import Task
from aerotube.runtime.windows import compute
from tests.runtime.test_windows import Failing
from tests.samples import BOX, HALF_WIDTHS, TABLE2_CONTROL, aircraft, table2, table2_state

NOMINAL = table2(12)
OWN = range(4, 8)
ON_ELLIPSOID = SynthesisSettings(noise_weight=1.0, control_weight=1e-2, limits="ellipsoid")
RATES = 0.5, 1e5, 1.0, 1.0  # rad/s, N/s, rad/s, rad/s
WITH_RATES = SynthesisSettings(noise_weight=1.0, control_weight=1e-2, rate_limits=RATES)


def kept_on(nominal, settings):
    """The window of Table 2, and which of its laws are kept on another nominal however much their tubes grow there."""
    task = Task(aircraft(), BOX, settings, window=4, workers=1)
    made = compute(task, NOMINAL, OWN)
    assert (made.rungs[:4] == Rung.PLANNED).all()
    return task, made, compute(replace(task, tolerance=1e9), nominal, OWN, before=made).kept[:4]


def throttled(change):
    return constant_controls(aircraft(), table2_state(), TABLE2_CONTROL + change * np.eye(4)[1], 0.05, 12)


def stepped(change):
    """Table 2 with a step of the elevator between the sixth and the seventh beat."""
    controls, states = NOMINAL.controls.copy(), NOMINAL.states.copy()
    controls[6:, 0] += change
    step = aircraft().compiled_step()
    for t in range(12):
        states[t + 1] = step(states[t][None], controls[t][None], np.ones((1, 1)), np.zeros((1, 6)), 0.05, 1)[0]
    return Nominal(0.05, states, controls)


def increments(task, made, errors):
    return made.laws.batch(task.form, task.coordinates).increments(np.arange(len(made.beats)), errors)


def most_on_ellipsoid(task, made, nominal, part):
    """Increments of the part's controls (b, m) at the errors of its ellipsoid that move each the most."""
    around = initial_ellipsoid(BOX, task.coordinates, nominal.states[:-1], part)
    count, own = len(made.beats), list(part.errors)
    inverse = np.linalg.inv(around.shape[made.beats])
    slopes = made.laws.coefficients[:, list(part.controls)][:, :, own]
    worst = np.einsum("bij,bmj->bmi", inverse, slopes)
    worst *= np.sqrt(around.rho[made.beats, None] / np.einsum("bmi,bmi->bm", slopes, worst))[..., None]
    errors = np.zeros((count, len(part.controls), 8))
    errors[..., own] = worst
    size = np.einsum("bmi,bij,bmj->bm", worst, around.shape[made.beats], worst)
    assert size == pytest.approx(np.broadcast_to(around.rho[made.beats, None], size.shape))
    return np.diagonal(increments(task, made, errors)[:, :, list(part.controls)], axis1=1, axis2=2)


@pytest.mark.parametrize("change", [0.0, 0.09, -0.09])
def test_the_limits_on_the_ellipsoid_where_they_were_asked_for(change):
    nominal = throttled(change)
    task, made, kept = kept_on(nominal, ON_ELLIPSOID)
    ground = groundwork(aircraft(), nominal, BOX, ON_ELLIPSOID)
    within = np.ones(4, bool)
    for part, room in zip(ON_ELLIPSOID.parts, ground.parts, strict=True):
        most = most_on_ellipsoid(task, made, nominal, part)[:4]
        least = np.minimum(-room.lower, room.upper)[4:8]
        within &= (most <= (1.0 + 1e-6) * least).all(axis=1)
    assert kept.tolist() == within.tolist()
    assert kept.all() == (change == 0.0)


def test_on_the_box_alone_more_of_them_would_be_kept():
    *_, kept = kept_on(throttled(0.09), replace(ON_ELLIPSOID, limits="box"))
    assert kept.any()
    assert not kept_on(throttled(0.09), ON_ELLIPSOID)[2].any()


@pytest.mark.parametrize("change", [0.0, 1.0])
def test_the_share_of_the_rate_that_a_step_of_the_nominal_leaves(change):
    nominal = stepped(np.radians(change))
    task, made, kept = kept_on(nominal, WITH_RATES)
    corners = np.array([*itertools.product((-1.0, 1.0), repeat=8)]) * HALF_WIDTHS
    elevator = np.abs(increments(task, made, np.tile(corners, (len(made.beats), 1, 1)))[:4, :, 0]).max(axis=1)
    # a beat's law may take half of what the rate leaves it to the beat before and to the beat after
    left = 0.5 * (RATES[0] * 0.05 - np.radians(change) * np.array([0, 1, 1, 0]))
    assert kept.tolist() == (elevator <= (1.0 + 1e-6) * left).tolist()
    assert kept.tolist() == [True, not change, not change, True]


@pytest.mark.parametrize(("change", "flown"), [(0.0, Rung.LAST), (1.0, Rung.LQR)])
def test_a_last_law_is_held_within_its_share_of_the_rate_only(monkeypatch, change, flown):
    monkeypatch.setattr(tasks, "design", Failing([(1, 0, "infeasible")]))
    task = Task(aircraft(), BOX, WITH_RATES, window=4, workers=1)
    rungs = compute(task, stepped(np.radians(change)), OWN).rungs[:4, 0]
    assert rungs.tolist() == [Rung.PLANNED, flown, Rung.PLANNED, Rung.PLANNED]
