"""Where a beat's law comes from when its window is late: down the ladder, rung by rung."""

import numpy as np

from aerotube.dynamics import ErrorCoordinates
from aerotube.runtime.channels import QueueChannel
from aerotube.runtime.commander import Commander
from aerotube.runtime.guidance import Guidance
from aerotube.runtime.messages import Rung
from aerotube.runtime.pilot import Pilot
from aerotube.runtime.session import Session
from aerotube.runtime.windows import Task
from aerotube.runtime.workers import Workers
from tests.runtime.test_windows import SETTINGS
from tests.samples import BOX, HALF_WIDTHS, aircraft, table2


def pilot():
    nominal = table2(12)
    commander = Commander(aircraft(), ErrorCoordinates(), nominal.dt, None, 20.0 * HALF_WIDTHS)
    guidance = Guidance(aircraft(), nominal)
    task = Task(aircraft(), BOX, SETTINGS, window=4)
    return Pilot(Session(QueueChannel.pair()[0], 1), task, guidance, commander, Workers(1), 24, 1.0)


def gains(value):
    return np.full((4, 8), float(value))


def test_the_ladder_of_a_late_window():
    made, sizes = pilot(), np.ones(2)
    planned, rungs = np.zeros(2, int), np.full(2, int(Rung.LAST))
    nominal = made.guidance.planned
    # the beat is the sixth of the second manoeuvre
    made._nominals[18] = nominal
    found = made._best(18)
    assert (found[0] == 0).all()
    assert (found[1] == Rung.NOMINAL).all()
    assert found[3]
    made._earlier_lqr[6] = gains(1)
    assert made._best(18)[0][0, 0] == 1
    made._lqr[18] = gains(2)
    found = made._best(18)
    assert found[0][0, 0] == 2
    assert (found[1] == Rung.LQR).all()
    made._earlier[6] = (gains(3), planned, sizes), table2(12, "smooth")
    assert made._best(18)[0][0, 0] == 2, "certified on another nominal"
    made._earlier[6] = (gains(3), planned, sizes), nominal
    found = made._best(18)
    assert found[0][0, 0] == 3
    assert (found[1] == Rung.LAST).all()
    made._held[18] = gains(4), rungs, sizes
    found = made._best(18)
    assert found[0][0, 0] == 4
    assert (found[1] == Rung.LAST).all()
    assert found[3]
    made._planned[18] = gains(5), planned, sizes
    found = made._best(18)
    assert found[0][0, 0] == 5
    assert (found[1] == Rung.PLANNED).all()
    assert not found[3]


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
