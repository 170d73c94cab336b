"""Windows of laws: the whole design's numbers, and the ladder where something fails."""

from dataclasses import replace

import numpy as np
import pytest

from aerotube.compensation import KINDS, SynthesisSettings, design, flown_size, measure
from aerotube.dynamics import ErrorCoordinates
from aerotube.nominal import constant_controls
from aerotube.runtime import assembly
from aerotube.runtime import task as tasks
from aerotube.runtime.law import Form
from aerotube.runtime.messages import Rung
from aerotube.runtime.sizes import Sized
from aerotube.runtime.task import Task
from aerotube.runtime.windows import compute
from tests.samples import BOX, aircraft, table2

NOMINAL = table2(12)
SETTINGS = SynthesisSettings(noise_weight=1.0, control_weight=1e-2)
TASK = Task(aircraft(), BOX, SETTINGS, window=4, workers=1)


@pytest.fixture(scope="module")
def whole():
    return design(aircraft(), NOMINAL, BOX, SETTINGS)


@pytest.fixture(scope="module")
def window():
    return compute(TASK, NOMINAL, range(4, 8))


def test_a_windows_laws_are_those_of_the_whole_nominal(window, whole):
    assert window.laws.coefficients[:4] == pytest.approx(whole.law.gains[4:8], rel=1e-9)
    assert (window.rungs[:4] == Rung.PLANNED).all()
    assert window.designed == 8


def test_sizes_are_those_of_the_tubes(window, whole):
    metric = tuple(m[4:8] for m in whole.metric)
    tubes, _ = measure(aircraft(), NOMINAL, BOX, whole.law, metric, SETTINGS, beats=range(4, 8))
    assert (tubes.certificate == "sampled").all()
    assert (window.kinds[:4] == KINDS.index("sampled")).all()
    assert np.maximum(window.size[:4], tubes.polynomial_size) == pytest.approx(tubes.size, rel=1e-6)
    assert window.messages == ()


def test_polynomials_sizes_say_that_they_are_no_more(whole):
    settings = replace(SETTINGS, certificate="polynomial only")
    found = compute(replace(TASK, settings=settings), NOMINAL, range(4, 8))
    metric = tuple(m[4:8] for m in whole.metric)
    tubes, _ = measure(aircraft(), NOMINAL, BOX, whole.law, metric, settings, beats=range(4, 8))
    assert (found.kinds[:4] == KINDS.index("polynomial only")).all()
    assert found.size[:4] == pytest.approx(tubes.size, rel=1e-3)
    assert (found.size[:4] >= (1 - 1e-7) * tubes.size).all()


def test_rigorous_certificates_are_not_claimed_in_flight():
    found = compute(replace(TASK, settings=replace(SETTINGS, certificate="rigorous")), NOMINAL, range(4, 6))
    assert (found.kinds[:2] == KINDS.index("sampled")).all()
    assert any("less than 'rigorous'" in message for message in found.messages)


def test_beats_behind_the_window_hold_its_last_law_where_that_is_certified(window):
    behind = window.rungs[4:]
    assert len(behind) == TASK.validity
    for part, own in zip(SETTINGS.parts, behind.T, strict=True):
        for j in np.flatnonzero(own == Rung.LAST):
            assert window.laws.coefficients[4 + j, part.controls] == pytest.approx(
                window.laws.coefficients[3, part.controls]
            )
    assert np.isfinite(window.size[4:][behind == Rung.LAST]).all()


class Failing:
    """A design in which chosen programs fail in a chosen way."""

    def __init__(self, broken):
        self.broken = broken

    def __call__(self, *arguments, **options):
        made = design(*arguments, **options)
        feasible, stopped, gains = made.feasible.copy(), made.stopped.copy(), made.law.gains.copy()
        for place, part, how in self.broken:
            feasible[place, part] = how == "reversed"
            if how == "reversed":
                gains[made.beats[place], SETTINGS.parts[part].controls] *= -1.0
            stopped[place, part] = how == "stopped"
            if how == "infeasible":
                gains[made.beats[place], SETTINGS.parts[part].controls] = 0.0
        return replace(made, feasible=feasible, stopped=stopped, law=replace(made.law, gains=gains))


def test_the_ladder_in_its_order(monkeypatch):
    """Stopped at the deadline; then nothing at all; and nothing from the start."""
    monkeypatch.setattr(tasks, "design", Failing([(1, 0, "stopped"), (2, 0, "infeasible"), (0, 1, "infeasible")]))
    window = compute(TASK, NOMINAL, range(4, 8))
    assert window.rungs[:4, 0].tolist() == [Rung.PLANNED, Rung.ANYTIME, Rung.LAST, Rung.PLANNED]
    assert window.laws.coefficients[2, :2] == pytest.approx(window.laws.coefficients[1, :2])
    # a first beat has none before it: the regulator
    assert window.rungs[0, 1] == Rung.LQR
    assert window.laws.coefficients[0, 2:].any()
    assert np.isnan(window.size[0, 1])
    assert np.isfinite(window.size[:4, 0]).all()


def test_a_law_that_is_worse_than_none_is_not_held(monkeypatch):
    """A law turned about pushes errors on: certified for what it is, and flown where it was made, but not held."""
    monkeypatch.setattr(tasks, "design", Failing([(1, 0, "reversed"), (2, 0, "infeasible")]))
    window = compute(TASK, NOMINAL, range(4, 8))
    assert window.rungs[:4, 0].tolist() == [Rung.PLANNED, Rung.PLANNED, Rung.LQR, Rung.PLANNED]
    assert np.isfinite(window.size[1, 0])


def test_what_is_not_certified_is_not_flown(monkeypatch):
    def sizes(task, nominal, beats, laws, metric):
        shape = len(beats), len(task.settings.parts)
        return Sized(np.full(shape, np.nan), np.full(shape, -1))

    monkeypatch.setattr(assembly, "sizes", sizes)
    window = compute(TASK, NOMINAL, range(4, 8))
    assert (window.rungs >= Rung.LQR).all()
    assert (window.kinds == -1).all()


def test_a_solver_without_time_leaves_certified_laws_or_none():
    window = compute(TASK, NOMINAL, range(4, 8), budget=1e-9)
    assert (window.rungs[:4] != Rung.PLANNED).all()
    assert np.isfinite(window.size[window.rungs == Rung.ANYTIME]).all()


def test_programs_solved_a_few_at_a_time_are_the_same(window):
    found = compute(TASK, NOMINAL, range(4, 8), budget=1e3)
    assert found.laws.coefficients == pytest.approx(window.laws.coefficients, rel=1e-9)
    assert found.rungs.tolist() == window.rungs.tolist()
    assert found.size == pytest.approx(window.size, rel=1e-9)


def slower(share):
    """The nominal flown from a lower airspeed: another trajectory, on which the old laws are worth less or more."""
    start = NOMINAL.states[0].copy()
    start[:3] *= 1.0 - share
    return constant_controls(aircraft(), start, NOMINAL.controls[0], NOMINAL.dt, NOMINAL.beats)


def test_laws_are_kept_where_their_certified_tubes_allow_and_nowhere_else(window, whole):
    same = compute(replace(TASK, tolerance=0.0), NOMINAL, range(4, 8), before=window)
    assert same.kept[:4].all()
    assert same.designed == 0
    assert same.laws.coefficients[:4] == pytest.approx(window.laws.coefficients[:4])
    nominal, metric = slower(-0.1), tuple(m[:4] for m in window.metric)
    size, _ = flown_size(aircraft(), nominal, BOX, whole.law, metric, SETTINGS, beats=range(4, 8))
    growth = (size / window.made[:4]).max(1) - 1.0
    tolerance = float(np.median(growth))
    assert tolerance > 0, "on this nominal the old laws' tubes do not grow: it tests nothing"
    kept = compute(replace(TASK, tolerance=tolerance), nominal, range(4, 8), before=window).kept[:4]
    assert (kept == (growth <= tolerance)).all()
    assert 0 < kept.sum() < 4


def test_tolerance_counts_from_where_a_law_was_made(window):
    """Small steps must not add up unseen."""
    task = replace(TASK, tolerance=0.05)
    once = compute(task, slower(-0.005), range(4, 8), before=window)
    kept = once.kept[:4]
    assert kept.any()
    assert (once.size[:4][kept] != window.made[:4][kept]).any()
    assert once.made[:4][kept] == pytest.approx(window.made[:4][kept])


def test_reuse_shares_laws_and_is_part_of_the_plan():
    task = replace(TASK, settings=replace(SETTINGS, reuse=1))
    window = compute(task, NOMINAL, range(4, 8))
    assert window.laws.coefficients[0] == pytest.approx(window.laws.coefficients[1])
    assert window.laws.coefficients[2] == pytest.approx(window.laws.coefficients[3])
    assert (window.rungs[:4] == Rung.PLANNED).all()
    assert window.designed == 4


@pytest.mark.parametrize("chosen", [{"saturation": 3.0}, {"law_degree": 2}, {"law_degree": 3, "saturation": 2.0}])
def test_windows_hold_laws_of_any_form(chosen):
    """The design's laws, room and reach, with the sizes of their tubes; the last law goes on behind the window."""
    settings = replace(SETTINGS, **chosen)
    made = design(aircraft(), NOMINAL, BOX, settings, beats=range(4, 7))
    found = compute(replace(TASK, settings=settings), NOMINAL, range(4, 7))
    assert (found.rungs[:3] == Rung.PLANNED).all()
    assert found.laws.coefficients[:3] == pytest.approx(
        getattr(made.law, "coefficients", made.law.gains)[4:7], rel=1e-7, abs=1e-9
    )
    metric = tuple(m for m in made.metric)
    tubes, _ = measure(aircraft(), NOMINAL, BOX, made.law, metric, settings, beats=range(4, 7))
    assert np.maximum(found.size[:3], tubes.polynomial_size) == pytest.approx(tubes.size, rel=1e-6)
    if settings.saturation > 1:
        assert found.laws.room[:3] == pytest.approx(made.law.room[4:7])
    else:
        assert np.isinf(found.laws.room).all()
    error = np.random.default_rng(1).uniform(-2, 2, (len(found.beats), 5, 8)) * BOX.half_widths
    batch = found.laws.batch(Form.of(settings), ErrorCoordinates())
    assert batch.increments(np.arange(3), error[:3]) == pytest.approx(
        made.law.increments(np.arange(4, 7), error[:3]), rel=1e-7, abs=1e-9
    )
    behind = found.rungs[3:] == Rung.LAST
    for part, own in zip(settings.parts, behind.T, strict=True):
        for j in np.flatnonzero(own):
            assert found.laws.coefficients[3 + j, part.controls] == pytest.approx(
                found.laws.coefficients[2, part.controls]
            )
    kept = compute(replace(TASK, settings=settings, tolerance=0.0), NOMINAL, range(4, 7), before=found)
    # laws of higher degree are not known to keep their limits by a sum over monomials: then they are made anew
    assert kept.kept[:3].all() or settings.saturation == 1.0
    assert kept.laws.coefficients[:3] == pytest.approx(found.laws.coefficients[:3], rel=1e-7, abs=1e-9)
    assert kept.laws.room[:3] == pytest.approx(found.laws.room[:3])
