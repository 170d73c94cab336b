"""The aircraft's side: it flies against a clock that does not wait, measures, and takes commands."""

from __future__ import annotations

import multiprocessing
import time
from contextlib import suppress
from typing import Any

import numpy as np

from aerotube.runtime.channels import Channel
from aerotube.runtime.messages import STATES, Kind
from aerotube.runtime.plant import Plant
from aerotube.runtime.session import Session
from aerotube.runtime.world import Truth, World

#: Share of a beat for which the aircraft waits for the beat's command before it flies on with the last one.
GRACE = 0.3
_HELLO_EVERY = 0.05  # s
_LEAD = 0.05  # s between the controller's word that it is ready and take-off
_ALERT = 1e-3  # s for which a command is waited for without sleeping
_PATIENCE = 30.0  # s without a word from the controller, in a flight without a clock, before it is given up


def fly(world: World, channel: Channel) -> Truth:
    """Fly all manoeuvres against the clock, talking to a controller.

    Parameters
    ----------
    world : World
    channel : Channel

    Returns
    -------
    Truth
    """
    plant, session = Plant(world), Session(channel, world.token)
    plant.advance(0, 0)  # compiles, or loads what is compiled
    plant.begin(0)
    if not _take_off(world, plant, session):
        return plant.truth(0)
    clocked = bool(np.isfinite(world.speed))
    length = world.dt / world.speed if clocked else 0.0
    start = time.monotonic() + _LEAD
    for m in range(world.manoeuvres):
        if m:
            plant.begin(m)
        for k in range(world.beats):
            due = start + (m * world.beats + k) * length
            if not _beat(plant, session, k, due, length if clocked else None):
                session.send(Kind.GOODBYE)
                return plant.truth(m)
    _sleep_until(start + world.manoeuvres * world.beats * length if clocked else 0.0)
    session.send(Kind.GOODBYE)
    return plant.truth(world.manoeuvres)


def _take_off(world: World, plant: Plant, session: Session) -> bool:
    """Say hello until the controller is ready; False if it says goodbye or is no more."""
    values = (world.dt, float(world.beats), float(len(plant.state)), min(world.speed, 1e300))
    controller = multiprocessing.parent_process()
    while controller is None or controller.is_alive():
        session.send(Kind.HELLO, values=values)
        answer = session.receive(_HELLO_EVERY)
        if answer is not None and answer.kind == Kind.GOODBYE:
            return False
        if answer is not None and answer.kind == Kind.HELLO:
            return True
    return False


def _beat(plant: Plant, session: Session, beat: int, due: float, length: float | None) -> bool:
    """Fly one beat; False if the controller has said goodbye or is gone.

    In the last beat goodbye is no reason to stop short: the controller says it when its last command is out, and that
    may have been lost.
    """
    world = plant.world
    number = plant.manoeuvre * world.beats + beat
    last, over = number == world.manoeuvres * world.beats - 1, False
    if length is not None:
        _sleep_until(due)
    measured = np.zeros(STATES)
    measured[: len(plant.state)] = plant.measure(beat)
    session.send(Kind.MEASUREMENT, number, tuple(measured.tolist()))
    plant.next_beat()
    for substep in range(world.substeps):
        if plant.taken[plant.manoeuvre, beat] < 0 and not over:
            grace = due + GRACE * length if length is not None and substep == 0 else 0.0
            until = time.monotonic() + _PATIENCE if length is None else grace
            heard = _listen(plant, session, number, until)
            over = heard is None or (not heard and length is None)
            if over and not last:
                return False
            if heard:
                plant.taken[plant.manoeuvre, beat] = substep
        plant.advance(beat, substep)
        if length is not None and substep < world.substeps - 1:
            _sleep_until(due + (substep + 1) * length / world.substeps)
    return True


def _listen(plant: Plant, session: Session, number: int, until: float) -> bool | None:
    """Wait for the command of a beat: True if it came, None for goodbye."""
    alert = min(time.monotonic() + _ALERT, until)
    while True:
        message = None
        while message is None and time.monotonic() < alert:
            message = session.receive(0.0)
        if message is None:
            message = session.receive(max(until - time.monotonic(), 0.0))
        if message is None:
            return False
        if message.kind == Kind.GOODBYE:
            return None
        if message.kind == Kind.COMMAND and message.beat == number and plant.command(message.values):
            return True


def _sleep_until(moment: float) -> None:
    left = moment - time.monotonic()
    if left > 0:
        time.sleep(left)


def run(world: World, channel: Channel, report: Any) -> None:
    """Fly in a process of its own and send the truth home through a pipe."""
    truth = None
    with suppress(KeyboardInterrupt):  # the controller has heard it too, and ends the session
        truth = fly(world, channel)
    with suppress(OSError):  # nobody waits for it any more
        report.send(truth)
    report.close()
