"""What a run has computed so far, part by part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from aerotube.flight import Containment
from aerotube.sos import Certificate
from aerotube.verify import Margins

Array = NDArray[np.float64]

STATES = ("V", "alpha", "q", "theta", "beta", "p", "r", "phi")
STATE_UNITS = ("m/s", "rad", "rad/s", "rad", "rad", "rad/s", "rad/s", "rad")
CONTROLS = ("elevator", "throttle", "aileron", "rudder")
CONTROL_UNITS = ("rad", "1", "rad", "rad")
CALM, NOISE, ESTIMATOR = "noise-free", "noise", "noise+estimator"
#: Condition -> ending of its keys in the summary.
KEY_SUFFIX = {CALM: "", NOISE: "_noise", ESTIMATOR: "_estimator"}
CONTROLLERS = ("none", "compensated", "lqr")
CONTROLLER_WORDS = {
    "none": "without compensation",
    "compensated": "with compensation",
    "lqr": "time-varying LQR",
}
CONDITION_WORDS = {
    CALM: "no sensor noise",
    NOISE: "sensor noise",
    ESTIMATOR: "noise, state estimator",
}
#: The setting of the synthesis that is flown in each condition; the estimator takes the noise away.
SETTING: dict[str, Literal["noise_free", "noise"]] = {CALM: "noise_free", NOISE: "noise", ESTIMATOR: "noise_free"}


@dataclass(frozen=True)
class Law:
    """Tubes and gains of one setting of the synthesis, as arrays.

    Attributes
    ----------
    parts : tuple of (str, tuple of int)
        Name of each part (half) that the synthesis is split into, and its indices into the error states.
    initial_shape, terminal_shape, nominal_shape : ndarray (beat, part, n, n)
        Ellipsoid shapes E, errors of a part in SI: at the start of a beat, and at its end with the law and
        without compensation.
    initial_rho, terminal_rho, nominal_rho : ndarray (beat, part)
        Their sizes: ``x'Ex <= rho``.
    metric : ndarray (beat, part, n, n)
        The metric in which the synthesis measured size.
    size, size_nominal : ndarray (beat, part)
        Least ``rho`` in that metric, with the law and without.
    gains : ndarray (beat, 4, 8)
        Linear part of the law, control increment (SI) per error (SI).
    coefficients : ndarray (beat, 4, M)
        Of all its monomials.
    exponents : ndarray (M, 8) of int
    coordinates : str
        Kind of the attitude errors, as of `aerotube.dynamics.ErrorCoordinates`.
    room : ndarray (beat, 4, 2) or None
        Least and largest increment, where the law cuts itself off; None: it never does.
    reach : ndarray (beat, 8, 8) or None
        Where it is its polynomial, see `aerotube.compensation.PolynomialLaw`; None: everywhere.
    feasible : ndarray of bool (beat, part)
    solve_seconds : ndarray (beat, part)
    certificate, certificate_nominal : ndarray of str (beat, part)
        What stands behind each tube, with the law and without it: "solver's word", "polynomial only", "sampled",
        "rigorous", or "none" where there is no tube.
    polynomial_size : ndarray (beat, part)
        Bound of the polynomials' size, to which the rest was added.
    shares : ndarray (beat, part, share)
        What each of `aerotube.compensation.SHARES` adds to it.
    control : ndarray (beat, part)
        What the nonlinearity of the control's effect can have added to the polynomials' size, of which it is a part.
    boundary : ndarray of bool (beat, part)
        Whether the boundary of the initial ellipsoid is enough.
    certify_seconds : ndarray (beat, part)
        Time of what was added to the polynomials' bounds.
    sampling : mapping
        Number, confidence, share and seed of the samples of "sampled" tubes.
    notes : tuple of str
        One sentence for each tube whose certificate is less than was asked for.
    messages : tuple of str
        One sentence for each infeasible beat.
    evidence : tuple of Certificate
        Of the sizes, one for each part.
    settings : mapping
        The keys of the synthesis.
    margins : Margins, optional
        Of the loops that the law closes.
    """

    parts: tuple[tuple[str, tuple[int, ...]], ...]
    initial_shape: Array
    initial_rho: Array
    terminal_shape: Array
    terminal_rho: Array
    nominal_shape: Array
    nominal_rho: Array
    metric: Array
    size: Array
    size_nominal: Array
    gains: Array
    coefficients: Array
    exponents: NDArray[np.int64]
    coordinates: str
    room: Array | None
    reach: Array | None
    feasible: NDArray[np.bool_]
    solve_seconds: Array
    certificate: NDArray[np.str_]
    certificate_nominal: NDArray[np.str_]
    polynomial_size: Array
    shares: Array
    control: Array
    boundary: NDArray[np.bool_]
    certify_seconds: Array
    sampling: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    messages: tuple[str, ...] = ()
    evidence: tuple[Certificate, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    margins: Margins | None = None


@dataclass(frozen=True)
class Case:
    """Flights of one controller in one condition, on the common draws.

    Attributes
    ----------
    error : ndarray (run, time, 8)
        Euler differences to the nominal of the first seed's runs, SI.
    command : ndarray (run, beat, 4)
        Controls of the first seed's runs, SI.
    upper_metric, mean_metric : ndarray (seed, time)
        Largest and mean metric (Eq. 18) over the runs of a seed.
    diverged : ndarray of bool (seed, run)
        Runs that diverged; from then on their last error counts.
    outside : ndarray of bool (seed, run)
        Runs that at some time were outside the range of the aircraft's tables.
    messages : tuple of str
        One sentence for each diverged run.
    law : str
        Which law or weights were flown, in words.
    containment : Containment, optional
        How the flights kept to the tubes of the law.
    """

    error: Array
    command: Array
    upper_metric: Array
    mean_metric: Array
    diverged: NDArray[np.bool_]
    outside: NDArray[np.bool_]
    messages: tuple[str, ...] = ()
    law: str = ""
    containment: Containment | None = None


@dataclass
class Record:
    """The parts of a run in the order in which they are computed; parts not reached are absent.

    Attributes
    ----------
    times : ndarray (time,)
        s.
    nominal_error_states : ndarray (time, 8)
        The nominal in the eight coordinates of the error state, SI.
    nominal_controls : ndarray (beat, 4)
        SI.
    nominal_states : ndarray (time, full_state)
        Full nominal states, SI.
    full_state_names, full_state_units : tuple of str
    half_widths : ndarray (8,)
        Of the disturbance box, SI.
    control_lower, control_upper : ndarray (4,)
        SI.
    seeds : tuple of int
    runs : int
        Runs per seed.
    conditions : tuple of str
        The conditions that were asked for.
    provenance : mapping
        Attributes that say where the numbers come from.
    coefficients : mapping, optional
        Aerodynamic coefficients over `coefficient_alpha` (rad), by name.
    laws : dict of Law
    cases : dict of Case
        By (controller, condition).
    problems : list of str
        Computed failures, one sentence each.
    seconds : dict of float
        How long each part took, in the order in which they were computed.
    interrupted : bool
    """

    times: Array
    nominal_error_states: Array
    nominal_controls: Array
    nominal_states: Array
    full_state_names: tuple[str, ...]
    full_state_units: tuple[str, ...]
    half_widths: Array
    control_lower: Array
    control_upper: Array
    seeds: tuple[int, ...]
    runs: int
    conditions: tuple[str, ...]
    provenance: Mapping[str, str]
    coefficient_alpha: Array | None = None
    coefficients: Mapping[str, Array] = field(default_factory=dict)
    laws: dict[str, Law] = field(default_factory=dict)
    cases: dict[tuple[str, str], Case] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    interrupted: bool = False
