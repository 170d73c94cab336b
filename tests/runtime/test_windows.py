"""Windows of laws: the whole design's numbers, and the ladder where something fails."""

from dataclasses import replace

import numpy as np
import pytest

from aerotube.compensation import SynthesisSettings, certified_size, design, measure
from aerotube.nominal import constant_controls
from aerotube.runtime import windows
from aerotube.runtime.messages import Rung
from aerotube.runtime.windows import Task, compute
from tests.samples import BOX, aircraft, table2

NOMINAL = table2(12)
SETTINGS = SynthesisSettings(noise_weight=1.0, control_weight=1e-2)
TASK = Task(aircraft(), BOX, SETTINGS, window=4, workers=1)


@pytest.fixture(scope="module")
def whole():
    return design(aircraft(), NOMINAL, BOX, SETTINGS)


@pytest.fixture(scope="module")
def laws():
    return compute(TASK, NOMINAL, range(4, 8))


def test_a_windows_laws_are_those_of_the_whole_nominal(laws, whole):
    assert laws.gains[:4] == pytest.approx(whole.law.gains[4:8], rel=1e-9)
    assert (laws.rungs[:4] == Rung.PLANNED).all()
    assert laws.designed == 8


def test_sizes_are_those_of_the_tubes(laws, whole):
    settings = replace(SETTINGS, certificate="polynomial only")
    metric = tuple(m[4:8] for m in whole.metric)
    tubes, _ = measure(aircraft(), NOMINAL, BOX, whole.law, metric, settings, beats=range(4, 8))
    assert laws.size[:4] == pytest.approx(tubes.size, rel=1e-3)
    assert (laws.size[:4] >= (1 - 1e-7) * tubes.size).all()


def test_beats_behind_the_window_hold_its_last_law_where_that_is_certified(laws):
    behind = laws.rungs[4:]
    assert len(behind) == TASK.validity
    for part, own in zip(SETTINGS.parts, behind.T, strict=True):
        for j in np.flatnonzero(own == Rung.LAST):
            assert laws.gains[4 + j, part.controls] == pytest.approx(laws.gains[3, part.controls])
    assert np.isfinite(laws.size[4:][behind == Rung.LAST]).all()


class Failing:
    """A design in which chosen programs fail in a chosen way."""

    def __init__(self, broken):
        self.broken = broken

    def __call__(self, *arguments, **options):
        made = design(*arguments, **options)
        feasible, stopped, gains = made.feasible.copy(), made.stopped.copy(), made.law.gains.copy()
        for place, part, how in self.broken:
            feasible[place, part] = False
            stopped[place, part] = how == "stopped"
            if how == "infeasible":
                gains[made.beats[place], SETTINGS.parts[part].controls] = 0.0
        return replace(made, feasible=feasible, stopped=stopped, law=replace(made.law, gains=gains))


def test_the_ladder_in_its_order(monkeypatch):
    """Stopped at the deadline; then nothing at all; and nothing from the start."""
    monkeypatch.setattr(windows, "design", Failing([(1, 0, "stopped"), (2, 0, "infeasible"), (0, 1, "infeasible")]))
    laws = compute(TASK, NOMINAL, range(4, 8))
    assert laws.rungs[:4, 0].tolist() == [Rung.PLANNED, Rung.ANYTIME, Rung.LAST, Rung.PLANNED]
    assert laws.gains[2, :2] == pytest.approx(laws.gains[1, :2])
    # a first beat has none before it: the regulator
    assert laws.rungs[0, 1] == Rung.LQR
    assert laws.gains[0, 2:].any()
    assert np.isnan(laws.size[0, 1])
    assert np.isfinite(laws.size[:4, 0]).all()


def test_a_law_that_is_worse_than_none_is_not_held(monkeypatch):
    monkeypatch.setattr(windows, "design", Failing([(2, 0, "infeasible")]))

    def sizes(task, nominal, beats, gains, metric):
        found = certified_size(task.aircraft, nominal, task.disturbance, None, metric, task.settings, beats=beats)
        return found if gains is None else 2.0 * found

    monkeypatch.setattr(windows, "_sizes", sizes)
    laws = compute(TASK, NOMINAL, range(4, 8))
    assert laws.rungs[:4, 0].tolist() == [Rung.PLANNED, Rung.PLANNED, Rung.LQR, Rung.PLANNED]


def test_what_is_not_certified_is_not_flown(monkeypatch):
    def sizes(task, nominal, beats, gains, metric):
        return np.full((len(beats), len(task.settings.parts)), np.nan)

    monkeypatch.setattr(windows, "_sizes", sizes)
    laws = compute(TASK, NOMINAL, range(4, 8))
    assert (laws.rungs >= Rung.LQR).all()


def test_a_solver_without_time_leaves_certified_laws_or_none():
    laws = compute(TASK, NOMINAL, range(4, 8), deadline=1e-9)
    assert (laws.rungs[:4] != Rung.PLANNED).all()
    assert np.isfinite(laws.size[laws.rungs == Rung.ANYTIME]).all()


def slower(share):
    """The nominal flown from a lower airspeed: another trajectory, on which the old laws are worth less or more."""
    start = NOMINAL.states[0].copy()
    start[:3] *= 1.0 - share
    return constant_controls(aircraft(), start, NOMINAL.controls[0], NOMINAL.dt, NOMINAL.beats)


def test_laws_are_kept_where_their_certified_tubes_allow_and_nowhere_else(laws, whole):
    same = compute(replace(TASK, tolerance=0.0), NOMINAL, range(4, 8), before=laws)
    assert same.kept[:4].all()
    assert same.designed == 0
    assert same.gains[:4] == pytest.approx(laws.gains[:4])
    nominal, metric = slower(-0.1), tuple(m[:4] for m in laws.metric)
    size = certified_size(aircraft(), nominal, BOX, whole.law, metric, SETTINGS, beats=range(4, 8))
    growth = (size / laws.made[:4]).max(1) - 1.0
    tolerance = float(np.median(growth))
    assert tolerance > 0, "on this nominal the old laws' tubes do not grow: it tests nothing"
    kept = compute(replace(TASK, tolerance=tolerance), nominal, range(4, 8), before=laws).kept[:4]
    assert (kept == (growth <= tolerance)).all()
    assert 0 < kept.sum() < 4


def test_tolerance_counts_from_where_a_law_was_made(laws):
    """Small steps must not add up unseen."""
    task = replace(TASK, tolerance=0.05)
    once = compute(task, slower(-0.005), range(4, 8), before=laws)
    kept = once.kept[:4]
    assert kept.any()
    assert (once.size[:4][kept] != laws.made[:4][kept]).any()
    assert once.made[:4][kept] == pytest.approx(laws.made[:4][kept])


def test_reuse_shares_laws_and_is_part_of_the_plan():
    task = replace(TASK, settings=replace(SETTINGS, reuse=1))
    laws = compute(task, NOMINAL, range(4, 8))
    assert laws.gains[0] == pytest.approx(laws.gains[1])
    assert laws.gains[2] == pytest.approx(laws.gains[3])
    assert (laws.rungs[:4] == Rung.PLANNED).all()
    assert laws.designed == 4
