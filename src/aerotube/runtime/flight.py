"""A flight against the clock: the aircraft in its process, the controller here, and what came of it."""

from __future__ import annotations

import gc
import multiprocessing
import secrets
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from aerotube import flight
from aerotube.compensation import SynthesisSettings
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.errors import ComputationError, InputError
from aerotube.preparation import Prepared, drawn_parameters, estimated_parameters
from aerotube.runtime import plant as plants
from aerotube.runtime.channels import Channel, QueueChannel, SocketChannel
from aerotube.runtime.commander import Beat, Commander
from aerotube.runtime.faults import Faults, FaultyChannel
from aerotube.runtime.guidance import Guidance
from aerotube.runtime.law import Form, Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.pilot import Pilot
from aerotube.runtime.plant import Actuators, Truth, World
from aerotube.runtime.record import Record
from aerotube.runtime.session import Session
from aerotube.runtime.task import Task
from aerotube.runtime.watchdog import Watchdog
from aerotube.runtime.windows import compute
from aerotube.runtime.workers import Workers

Array = NDArray[np.float64]

#: The paper's runtime case (its Section 4.6): 3 m/s too slow, 0.3 degrees of sideslip, everything else on the nominal.
PAPER_DEVIATION = np.array([-3.0, 0.0, 0.0, 0.0, np.radians(0.3), 0.0, 0.0, 0.0])
_GATE = 20.0  # half-widths of the disturbance from what was expected, beyond which no measurement is believed
_SWITCH = 2e-4  # s after which a thread lets another one run: the controller must not wait for a worker


@dataclass(frozen=True)
class Options:
    """What is asked of a flight, beside its scenario.

    Attributes
    ----------
    speed : float
        Seconds of flight for one of the clock; infinite: no clock, everything waits for everything.
    duration : float or None
        s of flight; the manoeuvre is repeated, the last one flown to its end. None: once.
    window : int
        Beats of a window; 1 solves each beat during the beat before it ("on demand").
    reuse : int
        Beats that a law serves beyond its own.
    estimator : bool
    noise : float or None
        Sensor noise as a share of the disturbance box; the scenario's by default.
    deviation : {"paper", "box"}
        Initial error of every manoeuvre: the paper's, or drawn from the box with a mass error.
    gusts : str or None
        Severity, or "none"; the scenario's by default.
    delay : int
        Whole beats from a command to its effect.
    actuators : bool
        Lags and rate limits of the surfaces.
    replan : float
        Share of the controls' travel by which the nominal is moved at every window.
    tolerance : float or None
        Event-triggered recomputation: see `aerotube.runtime.windows`.
    faults : int
        Faults of link and sensors to inject, and of workers with them.
    seed : int
        Of draws, faults and guidance.
    workers : int
        Threads that solve.
    link : {"local", "udp", "thread"}
        Sockets between two processes, UDP on loopback between them, or a queue and a thread in this process.
    port : int or None
        Wait at this UDP port for an aircraft of somebody else's, instead of flying one's own.
    substeps : int
        Steps of the aircraft in a beat.
    around : float
        s before and after a window that the forecast looks at.
    """

    speed: float = 1.0
    duration: float | None = None
    window: int = 16
    reuse: int = 0
    estimator: bool = False
    noise: float | None = None
    deviation: Literal["paper", "box"] = "paper"
    gusts: str | None = None
    delay: int = 0
    actuators: bool = False
    replan: float = 0.0
    tolerance: float | None = None
    faults: int = 0
    seed: int = 1
    workers: int = 2
    link: Literal["local", "udp", "thread"] = "local"
    port: int | None = None
    substeps: int = 5
    around: float = 3.0

    def __post_init__(self) -> None:
        wrong = ""
        if not self.speed > 0:
            wrong = f"speed is {self.speed:g}; give how many seconds are flown in one second, or inf"
        elif self.duration is not None and not (np.isfinite(self.duration) and self.duration > 0):
            wrong = f"duration is {self.duration:g} s; give a positive time"
        elif self.window < 1 or self.reuse < 0 or self.delay < 0 or self.workers < 1 or self.substeps < 1:
            wrong = "window, workers and substeps must be at least 1, reuse and delay not negative"
        elif self.window % (self.reuse + 1):
            wrong = f"a window of {self.window} beats is no whole number of laws for {self.reuse + 1} beats each"
        elif self.faults and not np.isfinite(self.speed):
            wrong = "faults need a clock; choose a speed"
        elif self.faults < 0:
            wrong = f"{self.faults} faults are asked for; give none or more"
        elif self.tolerance is not None and not self.tolerance >= 0:
            wrong = f"the tolerance is {self.tolerance:g}; it must not be negative"
        elif self.noise is not None and not (np.isfinite(self.noise) and self.noise >= 0):
            wrong = f"noise is {self.noise:g}; give a share of the disturbance box, not negative"
        elif self.port is not None and not 1 <= self.port <= 65535:
            wrong = f"there is no port {self.port}; give one from 1 to 65535"
        if wrong:
            raise InputError(f"flight: {wrong}.")


@dataclass(frozen=True)
class Flown:
    """A flight that is over.

    Attributes
    ----------
    options : Options
    prepared : Prepared
    record : Record
        The controller's log.
    world : World
    truth : Truth or None
        The aircraft's; None if it was somebody else's or did not come home.
    alone : ndarray (manoeuvre, T + 1, 8) or None
        Errors of the same flights on the nominal controls alone.
    faults : Faults or None
    thefts : ndarray (k, 3)
        See `Watchdog.stop`.
    warm_up, first_window : float
        s before take-off: compiling or loading code, and computing the first window.
    token : int
    """

    options: Options
    prepared: Prepared
    record: Record
    world: World
    truth: Truth | None
    alone: Array | None
    faults: Faults | None
    thefts: Array
    warm_up: float
    first_window: float
    token: int = field(repr=False)


#: Called with the controller, again and again, while it flies.
View = Callable[[Pilot], None]


def fly(
    prepared: Prepared, options: Options, tell: Callable[[str], None] | None = None, view: View | None = None
) -> Flown:
    """Fly a scenario against the clock.

    Parameters
    ----------
    prepared : Prepared
    options : Options
    tell : callable, optional
        Told what is done before take-off.
    view : callable, optional
        Called a few times a second during the flight, from this thread.

    Returns
    -------
    Flown

    Raises
    ------
    InputError
        If the options do not fit the scenario.
    ComputationError
        If the aircraft's process does not start.

    Notes
    -----
    Ctrl-C ends the flight after the beat, and what was flown is returned.
    """
    say = tell or (lambda words: None)
    world, task = make_world(prepared, options), make_task(prepared, options)
    guidance = Guidance(prepared.rigid, prepared.nominal, options.replan, options.seed)
    estimator = make_estimator(prepared, options)
    commander = make_commander(prepared, estimator, task.form)
    beats = world.manoeuvres * world.beats
    say("starting the aircraft and the watchdog")
    own = options.port is None
    home, away = _link(options)
    process, report = _start(world, away, options) if own else (None, None)
    watchdog = Watchdog() if options.link != "thread" else None
    faults = _faults(options, world)
    workers = Workers(2)  # a window's, and one more so that a stalled one does not hold up the next window
    channel: Channel = home if faults is None else FaultyChannel(home, faults)
    session = Session(channel, world.token if own else None)
    pilot = Pilot(session, task, guidance, commander, workers, beats, options.speed, faults)
    interval = sys.getswitchinterval()
    # threads of BLAS that wait for work by spinning would take the cores from the aircraft and the solver
    blas = threadpool_limits(limits=1, user_api="blas")
    try:
        say("compiling, or loading compiled code")
        warm_up = _warm_up(prepared, commander, task)
        say(f"code ready in {warm_up:.1f} s; computing the first window")
        first_window = pilot.prepare()
        say(f"first window in {first_window:.2f} s; take-off")
        sys.setswitchinterval(_SWITCH)
        gc.collect()
        gc.freeze()
        _run(pilot, view)
    finally:
        if view is not None and hasattr(view, "close"):
            view.close()
        blas.restore_original_limits()
        sys.setswitchinterval(interval)
        gc.unfreeze()
        workers.close()
        truth = _home(process, report, session) if own else None
        thefts = watchdog.stop() if watchdog is not None else np.empty((0, 3))
        pilot.record.events += [(time.monotonic(), words) for words in (watchdog.troubles if watchdog else [])]
        home.close()
    alone = None if truth is None or not truth.flown_manoeuvres else fly_alone(world, truth, pilot.record)
    return Flown(
        options, prepared, pilot.record, world, truth, alone, faults, thefts, warm_up, first_window, world.token
    )


def make_world(prepared: Prepared, options: Options) -> World:
    """What the aircraft will meet."""
    nominal, chosen = prepared.nominal, prepared.source.scenario
    seconds = nominal.beats * nominal.dt
    runs = max(1, int(np.ceil((options.duration or seconds) / seconds - 1e-9)))
    share = 1.0 if options.deviation == "box" else 0.0
    uncertain = drawn_parameters(chosen.disturbance, prepared.plant, share)
    draws = flight.draw(chosen.disturbance.half_widths, [options.seed], runs, **uncertain)
    if options.deviation == "paper":
        draws = replace(draws, initial_error=np.tile(PAPER_DEVIATION, (runs, 1)))
    gusts = prepared.gusts
    if options.gusts is not None:
        gusts = None
        if options.gusts != "none":
            from aerotube.aircraft.f16_aerodynamics import SPAN

            start = nominal.states[0]
            severity: Any = options.gusts
            gusts = flight.Dryden(severity, float(start[12]), float(np.linalg.norm(start[:3])), SPAN)
    settled = prepared.plant.settled(tuple(nominal.controls[0]))
    return World(
        aircraft=prepared.plant,
        start=np.concatenate([nominal.states[0][:13], np.array(settled, dtype=float)]),
        controls=nominal.controls,
        dt=nominal.dt,
        draws=draws,
        noise=_noise(prepared, options),
        gusts=gusts,
        actuators=Actuators() if options.actuators else None,
        delay=options.delay,
        substeps=options.substeps,
        speed=options.speed,
        token=secrets.randbits(64),
    )


def flown_settings(prepared: Prepared, options: Options) -> SynthesisSettings:
    """The settings of the laws: the noisy ones where the law sees noise."""
    noisy = _noise(prepared, options) > 0 and not options.estimator
    return replace(prepared.settings["noise" if noisy else "noise_free"], reuse=options.reuse)


def make_task(prepared: Prepared, options: Options) -> Task:
    """What every window is computed from."""
    return Task(
        aircraft=prepared.model,
        disturbance=prepared.disturbance,
        settings=flown_settings(prepared, options),
        window=options.window,
        around=max(1, round(options.around / prepared.nominal.dt)),
        tolerance=options.tolerance,
        workers=options.workers,
    )


def make_estimator(prepared: Prepared, options: Options) -> flight.ExtendedKalmanFilter | None:
    """The estimator, if it is asked for."""
    if not options.estimator:
        return None
    disturbance = prepared.source.scenario.disturbance
    return flight.extended_kalman_filter(
        prepared.rigid,
        prepared.nominal,
        disturbance.half_widths,
        _noise(prepared, options),
        **estimated_parameters(disturbance),
    )


def make_commander(prepared: Prepared, estimator: flight.ExtendedKalmanFilter | None, form: Form) -> Commander:
    """From measurements to commands."""
    coordinates = ErrorCoordinates(prepared.settings["noise"].attitude)
    gate = _GATE * np.asarray(prepared.disturbance.half_widths)
    return Commander(prepared.plant, coordinates, prepared.nominal.dt, estimator, form, gate)


def _noise(prepared: Prepared, options: Options) -> float:
    return prepared.source.scenario.flight.noise if options.noise is None else options.noise


def _faults(options: Options, world: World) -> Faults | None:
    if not options.faults:
        return None
    share = min(1.0, 1.2 * options.faults / (world.manoeuvres * world.beats))
    lead = options.window * world.dt / options.speed
    return Faults(share, options.seed, worker_share=0.2, stall=3.0 * lead, limit=options.faults)


def _link(options: Options) -> tuple[Any, Any]:
    """The controller's end of the link and the aircraft's."""
    if options.port is not None:
        return SocketChannel.listen(options.port), None
    return {"local": SocketChannel.pair, "udp": SocketChannel.udp_pair, "thread": QueueChannel.pair}[options.link]()


def _start(world: World, channel: Any, options: Options) -> tuple[Any, Any]:
    """Start the aircraft: its process (or thread), and the pipe through which its log comes home."""
    context = multiprocessing.get_context("spawn")
    report, away = context.Pipe(duplex=False)
    if options.link == "thread":
        thread = threading.Thread(target=plants.run, args=(world, channel, away), name="aircraft", daemon=True)
        thread.start()
        return thread, report
    process = context.Process(target=plants.run, args=(world, channel, away), name="aircraft", daemon=True)
    try:
        process.start()
    except OSError as error:
        raise ComputationError(f"flight: the aircraft's process does not start ({error}).") from None
    away.close()
    channel.close()
    return process, report


def _warm_up(prepared: Prepared, commander: Commander, task: Task) -> float:
    """Run everything once that compiles when it runs first; seconds it took."""
    clock = time.perf_counter()
    nominal = prepared.nominal
    state = commander.aircraft.state_names
    start = np.concatenate([nominal.states[0][:13], np.zeros(len(state) - 13)])
    if len(state) > 13:
        start[13:] = commander.aircraft.settled(tuple(nominal.controls[0]))
    law = Laws.none(task.form, 1)[0]
    beat = Beat(nominal.states[0], nominal.controls[0], law, Rung.NOMINAL, nominal.states[1])
    commander.begin()
    for _ in range(3):
        commander.believes(start, beat)
        command = commander.command(0, start, beat)
        commander.after(0, beat, command.control)
    commander.begin()
    compute(task, nominal, range(1))
    return time.perf_counter() - clock


def _run(pilot: Pilot, view: View | None) -> None:
    """Fly in a thread of its own; this one shows it and hears Ctrl-C."""
    failure: list[BaseException] = []

    def work() -> None:
        try:
            pilot.fly()
        except BaseException as error:
            failure.append(error)

    thread = threading.Thread(target=work, name="controller")
    thread.start()
    while thread.is_alive():
        try:
            if view is not None:
                view(pilot)
            thread.join(0.2)
        except KeyboardInterrupt:
            pilot.stop.set()
    if failure:
        raise failure[0]


def _home(process: Any, report: Any, session: Session) -> Truth | None:
    """Wait for the aircraft's log."""
    from aerotube.runtime.messages import Kind

    truth: Truth | None = None
    for _ in range(40):
        session.send(Kind.GOODBYE)
        if report.poll(0.25):
            try:
                truth = report.recv()
            except EOFError:
                truth = None
            break
        if not process.is_alive():
            break
    process.join(2.0)
    if isinstance(process, multiprocessing.process.BaseProcess) and process.is_alive():
        process.terminate()
    return truth


def fly_alone(world: World, truth: Truth, record: Record) -> Array:
    """The same manoeuvres, wind and parameters on the nominal controls alone: errors (manoeuvre, T + 1, 8)."""
    from aerotube.dynamics.errors import euler_error
    from aerotube.dynamics.step import step

    runs, beats = truth.flown_manoeuvres, world.beats
    nominal = nominal_of(record.nominal_state, record.nominal_end, runs, beats)
    controls = record.nominal_control[: runs * beats].reshape(runs, beats, 4)
    state = ErrorCoordinates("euler").retract(world.start, world.draws.initial_error[:runs])
    out = np.empty((runs, beats + 1, 8))
    out[:, 0] = euler_error(state, nominal[:, 0])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for k in range(beats):
            state = step(
                world.aircraft,
                state,
                controls[:, k],
                world.dt,
                parameters=truth.parameters,
                wind=truth.wind[:, k],
                substeps=world.substeps,
            )
            out[:, k + 1] = euler_error(state, nominal[:, k + 1])
    return out


def nominal_of(state: Array, end: Array, manoeuvres: int, beats: int) -> Array:
    """The nominal as it was flown, of whole manoeuvres.

    Parameters
    ----------
    state, end : ndarray (g, 13)
        At the start and at the end of every beat.
    manoeuvres, beats : int

    Returns
    -------
    ndarray (manoeuvre, T + 1, 13)
    """
    count = manoeuvres * beats
    first = state[:count].reshape(manoeuvres, beats, -1)
    last = end[:count].reshape(manoeuvres, beats, -1)
    return np.concatenate([first, last[:, -1:]], axis=1)
