"""What is asked of a flight, and what its scenario and the options make together."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from aerotube import flight
from aerotube.compensation import SynthesisSettings
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.errors import InputError
from aerotube.preparation import Prepared, drawn_parameters, estimated_parameters
from aerotube.runtime.actuators import Actuators
from aerotube.runtime.commander import Commander
from aerotube.runtime.law import Form
from aerotube.runtime.task import Task
from aerotube.runtime.world import World

#: The paper's runtime case (its Section 4.6): 3 m/s too slow, 0.3 degrees of sideslip, everything else on the nominal.
PAPER_DEVIATION = np.array([-3.0, 0.0, 0.0, 0.0, np.radians(0.3), 0.0, 0.0, 0.0])
DEVIATIONS = ("paper", "box")
SEVERITIES = ("none", "light", "moderate", "severe")
#: Least length of a beat on the clock, s. Its command must be out within 0.3 of it: ten times what it takes in the
#: median (60 us) and twice the 99th percentile, on a machine that shares its cores; and for 1.2 ms before a measurement
#: nothing else is begun.
SHORTEST = 2e-3
_GATE = 20.0  # half-widths of the disturbance from what was expected, beyond which no measurement is believed


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
        Faults of link, sensors and workers to inject, all together.
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
        least = {"reuse": 0, "window": 1, "delay": 0, "workers": 1, "substeps": 1, "faults": 0}
        few = next((name for name, bound in least.items() if getattr(self, name) < bound), None)
        chosen = {"gusts": self.gusts, "deviation": self.deviation == "box", "delay": self.delay}
        of_own = next((name for name, value in (chosen | {"actuators": self.actuators}).items() if value), None)
        wrong = ""
        if not self.speed > 0:
            wrong = f"speed is {self.speed:g}; give how many seconds are flown in one second, or inf"
        elif self.duration is not None and not (np.isfinite(self.duration) and self.duration > 0):
            wrong = f"duration is {self.duration:g} s; give a positive time"
        elif few is not None:
            wrong = f"{few} is {getattr(self, few)}; give {least[few]} or more"
        elif self.deviation not in DEVIATIONS:
            wrong = f"there is no deviation {self.deviation!r}; choose {_listed(DEVIATIONS)}"
        elif self.gusts is not None and self.gusts not in SEVERITIES:
            wrong = f"there are no gusts {self.gusts!r}; choose {_listed(SEVERITIES)}"
        elif self.window % (self.reuse + 1):
            wrong = f"a window of {self.window} beats is no whole number of laws for {self.reuse + 1} beats each"
        elif self.faults and not np.isfinite(self.speed):
            wrong = "faults need a clock; choose a speed"
        elif self.tolerance is not None and not self.tolerance >= 0:
            wrong = f"event is {self.tolerance:g}; give the growth of a tube that is tolerated, 0 or more"
        elif self.noise is not None and not (np.isfinite(self.noise) and self.noise >= 0):
            wrong = f"noise is {self.noise:g}; give a share of the disturbance box, not negative"
        elif self.port is not None and not 1 <= self.port <= 65535:
            wrong = f"there is no port {self.port}; give one from 1 to 65535"
        elif self.port is not None and of_own:
            wrong = (
                f"{of_own} is of the aircraft that flies without a port; another's aircraft has its own: leave it out"
            )
        if wrong:
            raise InputError(f"flight: {wrong}.")


def _listed(names: tuple[str, ...]) -> str:
    return f"{', '.join(names[:-1])} or {names[-1]}"


def check_beat(prepared: Prepared, options: Options) -> None:
    """See that the clock leaves the runtime enough of each beat.

    Raises
    ------
    InputError
        If beats are shorter than `SHORTEST` on the clock.
    """
    length = prepared.nominal.dt / options.speed
    if np.isfinite(options.speed) and length < SHORTEST:
        raise InputError(
            f"flight: beats of {1e3 * length:g} ms on the clock are too short; {1e3 * SHORTEST:g} ms are the least "
            "that leaves the runtime its time, so make nominal.beat (--beat) longer or the speed lower, or fly without "
            "a clock (--speed inf)."
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
        noise=noise_of(prepared, options),
        gusts=gusts,
        actuators=Actuators() if options.actuators else None,
        delay=options.delay,
        substeps=options.substeps,
        speed=options.speed,
        token=secrets.randbits(64),
    )


def flown_settings(prepared: Prepared, options: Options) -> SynthesisSettings:
    """The settings of the laws: the noisy ones where the law sees noise."""
    noisy = noise_of(prepared, options) > 0 and not options.estimator
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
        noise_of(prepared, options),
        **estimated_parameters(disturbance),
    )


def make_commander(prepared: Prepared, estimator: flight.ExtendedKalmanFilter | None, form: Form) -> Commander:
    """From measurements to commands."""
    coordinates = ErrorCoordinates(prepared.settings["noise"].attitude)
    gate = _GATE * np.asarray(prepared.disturbance.half_widths)
    return Commander(prepared.plant, coordinates, prepared.nominal.dt, estimator, form, gate)


def flown_options(prepared: Prepared, options: Options) -> dict[str, str]:
    """What was flown, in words, by option of the command line; defaults and what the scenario says filled in."""
    chosen, nominal = prepared.source.scenario, prepared.nominal
    own = options.port is None
    theirs = "the other aircraft's own"
    deviation = {"paper": "the paper's", "box": "drawn from the disturbance set"}[options.deviation]
    gusts = chosen.flight.gusts if options.gusts is None else options.gusts
    link = {"local": "sockets of this machine", "udp": "UDP on loopback", "thread": "a queue in one process"}
    event = "no: every window is designed anew"
    if options.tolerance is not None:
        event = f"a law is kept while its tube grows by no more than {100 * options.tolerance:g} %"
    return {
        "speed": f"{options.speed:g}" if np.isfinite(options.speed) else "without a clock",
        "duration": "once through" if options.duration is None else f"{options.duration:g} s, whole manoeuvres",
        "window": f"{options.window} beats",
        "reuse": f"each law for {options.reuse} more beats" if options.reuse else "no",
        "algorithm": chosen.synthesis.algorithm,
        "beat": f"{1e3 * nominal.dt:g} ms",
        "estimator": _yes(options.estimator),
        "noise": f"{100 * noise_of(prepared, options):g} % of the disturbance box" + ("" if own else ", for the laws"),
        "deviation": deviation if own else theirs,
        "gusts": gusts if own else theirs,
        "actuators": _yes(options.actuators) if own else theirs,
        "delay": f"{options.delay} beats" if own else theirs,
        "replan": f"by {100 * options.replan:g} % of the controls' travel" if options.replan else "no",
        "event": event,
        "faults": str(options.faults),
        "seed": str(options.seed),
        "workers": str(options.workers),
        "link": link[options.link] if own else f"UDP port {options.port}",
        "substeps": str(options.substeps) if own else theirs,
        "look-around": f"{options.around:g} s before and after a window",
    }


def _yes(chosen: bool) -> str:
    return "yes" if chosen else "no"


def noise_of(prepared: Prepared, options: Options) -> float:
    """Sensor noise as a share of the disturbance box."""
    return prepared.source.scenario.flight.noise if options.noise is None else options.noise
