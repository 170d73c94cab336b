"""The aircraft's side: it flies against the clock, measures, and takes commands.

An undisturbed flight is that of :func:`aerotube.flight.simulate` with the same draws. What is added here is the
world: a clock that does not wait, commands that come late or not at all, actuators, and delays.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.dynamics.step import step
from aerotube.flight.draws import Draws
from aerotube.flight.gusts import CHANNELS, Dryden
from aerotube.runtime.channels import Channel
from aerotube.runtime.messages import STATES, Kind
from aerotube.runtime.session import Session

Array = NDArray[np.float64]

_EULER = ErrorCoordinates("euler")
_HELLO_EVERY = 0.05  # s
_LEAD = 0.05  # s between the controller's word that it is ready and take-off
#: Share of a beat for which the aircraft waits for the beat's command before it flies on with the last one.
GRACE = 0.3
_ALERT = 1e-3  # s for which a command is waited for without sleeping
_PATIENCE = 30.0  # s without a word from the controller, in a flight without a clock, before it is given up


@dataclass(frozen=True)
class Actuators:
    """First-order lags with rate limits, one for each control; the throttle has the engine's lag, if any.

    Attributes
    ----------
    bandwidth : ndarray (4,)
        1/s; infinite where there is no lag. Stevens and Lewis give 20.2 for the F-16's surfaces.
    rate : ndarray (4,)
        Largest rate, in the control's unit per second. Theirs: 60 deg/s elevator, 80 aileron, 120 rudder.
    """

    bandwidth: Array = field(default_factory=lambda: np.array([20.2, np.inf, 20.2, 20.2]))
    rate: Array = field(default_factory=lambda: np.array([*np.radians([60.0]), np.inf, *np.radians([80.0, 120.0])]))

    def move(self, position: Array, command: Array, seconds: float) -> Array:
        """Positions (4,) after some seconds under a command (4,)."""
        share = np.where(np.isinf(self.bandwidth), 1.0, -np.expm1(-np.minimum(self.bandwidth, 1e6) * seconds))
        most = np.where(np.isinf(self.rate), np.inf, self.rate * seconds)
        return np.asarray(position + np.clip(share * (command - position), -most, most))


@dataclass(frozen=True)
class World:
    """What the aircraft meets; can be sent to another process.

    Attributes
    ----------
    aircraft : Aircraft
        Flies; it may have states of its own after the nominal's.
    start : ndarray (n,)
        Its state at the start of every manoeuvre, undisturbed.
    controls : ndarray (T, 4)
        Of the nominal: flown until the first command is through the delay.
    dt : float
        Length of a beat, s.
    draws : Draws
        One run a manoeuvre.
    noise : float
        Sensor noise as a share of the disturbance box.
    gusts : Dryden or None
    actuators : Actuators or None
    delay : int
        Whole beats from a command to its effect.
    substeps : int
        Steps of the aircraft in a beat.
    speed : float
        Seconds of flight for one of the clock; infinite: no clock, every command is waited for.
    token : int
        Of the session.
    """

    aircraft: Aircraft
    start: Array
    controls: Array
    dt: float
    draws: Draws
    noise: float = 0.0
    gusts: Dryden | None = None
    actuators: Actuators | None = None
    delay: int = 0
    substeps: int = 5
    speed: float = 1.0
    token: int = 1

    @property
    def beats(self) -> int:
        """Beats of a manoeuvre."""
        return len(self.controls)

    @property
    def manoeuvres(self) -> int:
        """How often the manoeuvre is flown."""
        return self.draws.runs


@dataclass(frozen=True)
class Truth:
    """What really happened.

    Attributes
    ----------
    states : ndarray (manoeuvre, T + 1, n)
    flown : ndarray (manoeuvre, T, substep, 4)
        Positions of the controls.
    wind : ndarray (manoeuvre, T, 6)
    parameters : ndarray (manoeuvre, p)
    taken : ndarray (manoeuvre, T) of int
        Substep from which the beat's own command was there; -1: never.
    illegal : int
        Commands that were not finite or beyond the limits: not flown.
    flown_manoeuvres : int
        Less than were asked for where the session ended early.
    """

    states: Array
    flown: Array
    wind: Array
    parameters: Array
    taken: NDArray[np.int64]
    illegal: int
    flown_manoeuvres: int


class Plant:
    """The aircraft without the clock: one manoeuvre after the other, substep by substep."""

    def __init__(self, world: World) -> None:
        self.world = world
        runs, beats = world.manoeuvres, world.beats
        draws = world.draws
        self.noise = world.noise * draws.measurement_noise(beats) if world.noise > 0 else np.zeros((runs, beats, 8))
        still = np.zeros((runs, beats, 6))
        self.wind = still if world.gusts is None else world.gusts.sample(draws.gust_noise(beats, CHANNELS), world.dt)
        self._step = world.aircraft.compiled_step()
        n = len(world.start)
        self.states = np.full((runs, beats + 1, n), np.nan)
        self.flown = np.full((runs, beats, world.substeps, 4), np.nan)
        self.taken = np.full((runs, beats), -1)
        self.illegal = 0
        self._low, self._high = world.aircraft.control_lower, world.aircraft.control_upper
        self.begin(0)

    def begin(self, manoeuvre: int) -> None:
        """Put the aircraft at the start of a manoeuvre, off by its initial error."""
        world = self.world
        self.manoeuvre = manoeuvre
        self.state = _EULER.retract(world.start, world.draws.initial_error[manoeuvre])
        self.states[manoeuvre, 0] = self.state
        self._queue = [world.controls[min(k, world.beats - 1)] for k in range(world.delay)]
        self._position = self._effective = world.controls[0].copy()

    def measure(self, beat: int) -> Array:
        """Measured state, with the sensors' noise."""
        return _EULER.retract(self.state, self.noise[self.manoeuvre, beat])

    def command(self, values: tuple[float, ...] | Array) -> bool:
        """Take a command; one beyond the limits is not flown."""
        control = np.asarray(values)
        margin = 1e-9
        if (
            not (np.isfinite(control).all() and (control >= self._low - margin).all())
            or (control > self._high + margin).any()
        ):
            self.illegal += 1
            return False
        if self.world.delay:
            self._queue[-1] = control
        else:
            self._effective = control
        return True

    def next_beat(self) -> None:
        """Let the delayed commands move up; a beat without a command repeats the last."""
        if self.world.delay:
            self._effective = self._queue.pop(0)
            self._queue.append(self._queue[-1] if self._queue else self._effective)

    def advance(self, beat: int, substep: int) -> None:
        """Fly a substep."""
        world, m = self.world, self.manoeuvre
        seconds = world.dt / world.substeps
        if world.actuators is None:
            self._position = self._effective
        else:
            self._position = world.actuators.move(self._position, self._effective, seconds)
        self.flown[m, beat, substep] = self._position
        self.state = fly_substep(
            world.aircraft,
            self._step,
            self.state,
            self._position,
            world.draws.parameters[m],
            self.wind[m, beat],
            seconds,
        )
        if substep == world.substeps - 1:
            self.states[m, beat + 1] = self.state

    def truth(self, manoeuvres: int) -> Truth:
        """What happened, of the first manoeuvres."""
        return Truth(
            self.states[:manoeuvres],
            self.flown[:manoeuvres],
            self.wind[:manoeuvres],
            self.world.draws.parameters[:manoeuvres],
            self.taken[:manoeuvres],
            self.illegal,
            manoeuvres,
        )


def fly_substep(
    aircraft: Aircraft,
    compiled: Any,
    state: Array,
    control: Array,
    parameters: Array,
    wind: Array,
    seconds: float,
) -> Array:
    """State (n,) after a substep, by the aircraft's compiled step where it has one."""
    if compiled is None:
        return step(aircraft, state, control, seconds, parameters=parameters, wind=wind)
    return np.asarray(compiled(state[None], control[None], parameters[None], wind[None], seconds, 1)[0])


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
    """Say hello until the controller is ready; False if it says goodbye."""
    values = (world.dt, float(world.beats), float(len(plant.state)), min(world.speed, 1e300))
    while True:
        session.send(Kind.HELLO, values=values)
        answer = session.receive(_HELLO_EVERY)
        if answer is not None and answer.kind == Kind.GOODBYE:
            return False
        if answer is not None and answer.kind == Kind.HELLO:
            return True


def _beat(plant: Plant, session: Session, beat: int, due: float, length: float | None) -> bool:
    """Fly one beat; False if the controller has said goodbye or is gone."""
    world = plant.world
    number = plant.manoeuvre * world.beats + beat
    if length is not None:
        _sleep_until(due)
    measured = np.zeros(STATES)
    measured[: len(plant.state)] = plant.measure(beat)
    session.send(Kind.MEASUREMENT, number, tuple(measured.tolist()))
    plant.next_beat()
    for substep in range(world.substeps):
        if plant.taken[plant.manoeuvre, beat] < 0:
            grace = due + GRACE * length if length is not None and substep == 0 else 0.0
            until = time.monotonic() + _PATIENCE if length is None else grace
            heard = _listen(plant, session, number, until)
            if heard is None or (not heard and length is None):
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
    try:
        report.send(fly(world, channel))
    except KeyboardInterrupt:  # the controller has heard it too, and ends the session
        report.send(None)
    finally:
        report.close()
