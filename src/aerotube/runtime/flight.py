"""A flight against the clock: the aircraft in its process, the controller here, and what came of it."""

from __future__ import annotations

import gc
import multiprocessing
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from aerotube.errors import ComputationError
from aerotube.preparation import Prepared
from aerotube.runtime import aircraft_process
from aerotube.runtime.alone import fly_alone
from aerotube.runtime.channels import LOOPBACK, Channel, QueueChannel, SocketChannel
from aerotube.runtime.commander import Beat, Commander
from aerotube.runtime.faults import Faults, FaultyChannel
from aerotube.runtime.guidance import Guidance
from aerotube.runtime.law import Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.options import Options, check_beat, make_commander, make_estimator, make_task, make_world
from aerotube.runtime.pilot import Pilot
from aerotube.runtime.planner import window_starts
from aerotube.runtime.processes import deaf_to_interrupts, on_interrupt
from aerotube.runtime.record import Record
from aerotube.runtime.session import Session
from aerotube.runtime.task import Task
from aerotube.runtime.watchdog import Watchdog
from aerotube.runtime.windows import compute
from aerotube.runtime.workers import Workers
from aerotube.runtime.world import Truth, World

Array = NDArray[np.float64]

_SWITCH = 2e-4  # s after which a thread lets another one run: the controller must not wait for a worker


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
    interrupted : bool
        Ended by Ctrl-C before its last beat.
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
    interrupted: bool = False


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
    check_beat(prepared, options)
    world, task = make_world(prepared, options), make_task(prepared, options)
    guidance = Guidance(prepared.rigid, prepared.nominal, options.replan, options.seed)
    estimator = make_estimator(prepared, options)
    commander = make_commander(prepared, estimator, task.form)
    beats, faults = world.manoeuvres * world.beats, _faults(options, world)
    own = options.port is None
    say("starting the aircraft and the watchdog" if own else "starting the watchdog")
    home, away = _link(options)
    process, report = _start(world, away, options) if own else (None, None)
    watchdog = Watchdog() if options.link != "thread" else None
    workers = Workers(2)  # a window's, and one more so that a stalled one does not hold up the next window
    channel: Channel = home if faults is None else FaultyChannel(home, faults)
    session = Session(channel, world.token if own else None)
    pilot = Pilot(session, task, guidance, commander, workers, beats, options.speed, faults)
    interval = sys.getswitchinterval()
    # threads of BLAS that wait for work by spinning would take the cores from the aircraft and the solver
    blas = threadpool_limits(limits=1, user_api="blas")
    try:
        with on_interrupt(pilot.stop.set):
            say("compiling, or loading compiled code")
            warm_up = _warm_up(prepared, commander, task)
            say(f"code ready in {warm_up:.1f} s; computing the first window")
            first_window = pilot.prepare()
            say(f"first window in {first_window:.2f} s")
            if not own:
                for words in _waiting(options):
                    say(words)
            sys.setswitchinterval(_SWITCH)
            gc.collect()
            gc.freeze()
            _run(pilot, say, view)
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
        options=options,
        prepared=prepared,
        record=pilot.record,
        world=world,
        truth=truth,
        alone=alone,
        faults=faults,
        thefts=thefts,
        warm_up=warm_up,
        first_window=first_window,
        token=world.token,
        interrupted=pilot.stop.is_set() and pilot.record.flown < beats,
    )


def _waiting(options: Options) -> list[str]:
    """What is said before another's aircraft is there."""
    words = [f"waiting for an aircraft at UDP port {options.port} ({LOOPBACK}); Ctrl-C ends"]
    if options.replan:
        words.append(
            "the nominal that commands follow is moved at every window; the aircraft is not told, and need not be"
        )
    return words


def _faults(options: Options, world: World) -> Faults | None:
    if not options.faults:
        return None
    lead = options.window * world.dt / options.speed
    windows = window_starts(world.manoeuvres * world.beats, world.beats, options.window)
    # the first window is computed before take-off
    return Faults.spread(
        options.faults, world.manoeuvres * world.beats, windows[1:], seed=options.seed, stall=3.0 * lead
    )


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
        thread = threading.Thread(
            target=aircraft_process.run, args=(world, channel, away), name="aircraft", daemon=True
        )
        thread.start()
        return thread, report
    process = context.Process(target=aircraft_process.run, args=(world, channel, away), name="aircraft", daemon=True)
    try:
        with deaf_to_interrupts():
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


def _run(pilot: Pilot, say: Callable[[str], None], view: View | None) -> None:
    """Fly in a thread of its own; this one shows it and hears Ctrl-C."""
    failure: list[BaseException] = []

    def work() -> None:
        try:
            pilot.fly()
        except BaseException as error:
            failure.append(error)

    thread = threading.Thread(target=work, name="controller")
    thread.start()
    off = False
    while thread.is_alive():
        try:
            if not off and pilot.met.wait(0.2):
                off = True
                say("take-off")
            if off and view is not None:
                view(pilot)
            thread.join(0.2 if off else 0.0)
        except KeyboardInterrupt:
            pilot.stop.set()
        except Exception as error:  # of the view: what flies is not to be left alone for it
            view = None
            say(f"the live view has failed ({type(error).__name__}: {error}); the flight goes on without it")
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
