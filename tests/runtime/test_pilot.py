"""Where a beat's law comes from when its window is late: down the ladder, rung by rung."""

import numpy as np

from aerotube.dynamics import ErrorCoordinates
from aerotube.runtime.channels import QueueChannel
from aerotube.runtime.commander import Commander
from aerotube.runtime.guidance import Guidance
from aerotube.runtime.law import Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.pilot import Chosen, Pilot
from aerotube.runtime.session import Session
from aerotube.runtime.task import Task
from aerotube.runtime.workers import Workers
from tests.runtime.test_windows import SETTINGS
from tests.samples import BOX, HALF_WIDTHS, aircraft, table2


def pilot():
    nominal = table2(12)
    task = Task(aircraft(), BOX, SETTINGS, window=4)
    commander = Commander(aircraft(), ErrorCoordinates(), nominal.dt, None, task.form, 20.0 * HALF_WIDTHS)
    guidance = Guidance(aircraft(), nominal)
    return Pilot(Session(QueueChannel.pair()[0], 1), task, guidance, commander, Workers(1), 24, 1.0)


def gains(value):
    return np.full((4, 8), float(value))


def test_the_ladder_of_a_late_window():
    made = pilot()
    nominal = made.guidance.planned

    def certified(value, rung):
        law = Laws.linear(made.task.form, gains(value)[None])[0]
        return Chosen(law, np.full(2, int(rung)), np.ones(2), np.full(2, 2), np.eye(8))

    def best():
        chosen, late = made._best(18)
        return chosen.law.coefficients[0, 0], chosen.rungs.max(), chosen.kinds.min(), late

    # the beat is the sixth of the second manoeuvre
    made._nominals[18] = nominal
    assert best() == (0, Rung.NOMINAL, -1, True)
    made._earlier_lqr[6] = gains(1)
    assert best() == (1, Rung.LQR, -1, True)
    made._lqr[18] = gains(2)
    assert best() == (2, Rung.LQR, -1, True)
    made._earlier[6] = certified(3, Rung.PLANNED), table2(12, "smooth")
    assert best() == (2, Rung.LQR, -1, True), "certified on another nominal"
    made._earlier[6] = certified(3, Rung.PLANNED), nominal
    assert best() == (3, Rung.LAST, 2, True)
    made._held[18] = certified(4, Rung.LAST)
    assert best() == (4, Rung.LAST, 2, True)
    made._planned[18] = certified(5, Rung.PLANNED)
    assert best() == (5, Rung.PLANNED, 2, False)


def test_guidance_moves_only_what_is_still_to_come():
    nominal = table2(12)
    guidance = Guidance(aircraft(), nominal, change=0.05, seed=4)
    first = guidance.update(0, 0)
    second = guidance.update(0, 6)
    assert np.array_equal(first.states[:7], second.states[:7])
    assert np.array_equal(first.controls[:6], second.controls[:6])
    assert not np.allclose(first.controls[6:], second.controls[6:])
    step = aircraft().compiled_step()
    for t in range(12):
        ahead = step(second.states[t][None], second.controls[t][None], np.ones((1, 1)), np.zeros((1, 6)), nominal.dt, 1)
        assert np.abs(ahead[0] - second.states[t + 1]).max() < 1e-9
    assert Guidance(aircraft(), nominal).update(3, 6) is nominal
