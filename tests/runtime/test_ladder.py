"""Where a beat's law comes from when its window is late: down the ladder, rung by rung."""

import numpy as np

from aerotube.runtime.ladder import Chosen, Ladder
from aerotube.runtime.law import Form, Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.task import Task
from aerotube.runtime.windows import compute
from tests.runtime.test_windows import SETTINGS
from tests.samples import BOX, aircraft, table2


def ladder():
    return Ladder(Task(aircraft(), BOX, SETTINGS, window=4), table2(12))


def gains(value):
    return np.full((4, 8), float(value))


def test_the_ladder_of_a_late_window():
    made = ladder()
    nominal = made.nominal(18)

    def certified(value, rung):
        law = Laws.linear(Form.of(SETTINGS), gains(value)[None])[0]
        return Chosen(law, np.full(2, int(rung)), np.ones(2), np.full(2, 2), np.eye(8))

    def best():
        chosen, late = made.best(18)
        return chosen.law.coefficients[0, 0], chosen.rungs.max(), chosen.kinds.min(), late

    # the beat is the sixth of the second manoeuvre
    made.nominals[18] = nominal
    assert best() == (0, Rung.NOMINAL, -1, True)
    made.earlier_lqr[6] = gains(1)
    assert best() == (1, Rung.LQR, -1, True)
    made.lqr[18] = gains(2)
    assert best() == (2, Rung.LQR, -1, True)
    made.earlier[6] = certified(3, Rung.PLANNED), table2(12, "smooth")
    assert best() == (2, Rung.LQR, -1, True), "certified on another nominal"
    made.earlier[6] = certified(3, Rung.PLANNED), nominal
    assert best() == (3, Rung.LAST, 2, True)
    made.held[18] = certified(4, Rung.LAST)
    assert best() == (4, Rung.LAST, 2, True)
    made.planned[18] = certified(5, Rung.PLANNED)
    assert best() == (5, Rung.PLANNED, 2, False)


def test_a_window_that_comes_after_its_beats_leaves_nothing_behind():
    task, made = Task(aircraft(), BOX, SETTINGS, window=4, workers=1), ladder()
    nominal = table2(12)
    window = compute(task, nominal, range(4, 8))
    for beat in range(12, 18):  # the second manoeuvre, past the middle of its window
        made.forget(beat)
    made.decide(range(12, 24), nominal)
    made.install(window, 1, nominal)
    stores = made.planned, made.held, made.lqr, made.nominals
    assert min(min(store, default=18) for store in stores) == 18
    assert sorted(made.planned) == [18, 19]
    assert sorted(made.earlier) == [4, 5, 6, 7], "the next manoeuvre may fly them all"
    for beat in range(18, 24):
        made.forget(beat)
    made.decide(range(12, 24), nominal)
    made.install(window, 1, nominal)
    assert not any(stores)
