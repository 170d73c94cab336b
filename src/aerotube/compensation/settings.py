"""What is asked of a synthesis, and the parts it is split into."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from aerotube import sos
from aerotube.errors import InputError

Algorithm = Literal["decoupled", "coupled"]
Size = Literal["mean-square", "worst-case", "trace", "volume"]
SIZES: tuple[Size, ...] = ("mean-square", "worst-case", "trace", "volume")
Shape = Literal["cost-to-go", "riccati"]
Limits = Literal["box", "ellipsoid"]
Certificate = Literal["polynomial only", "sampled", "rigorous"]


#: Highest degrees of the programs that are found in reasonable time: beyond, a program's structure alone takes minutes.
MOST_DEGREE: dict[Algorithm, int] = {"decoupled": 8, "coupled": 6}


@dataclass(frozen=True)
class Part:
    """Some of the error states and the controls that steer them.

    Attributes
    ----------
    name : str
    errors : tuple of int
        Indices into the eight error components.
    controls : tuple of int
        Indices into the four controls.
    """

    name: str
    errors: tuple[int, ...]
    controls: tuple[int, ...]


DECOUPLED = (Part("longitudinal", (0, 1, 2, 3), (0, 1)), Part("lateral", (4, 5, 6, 7), (2, 3)))
COUPLED = (Part("coupled", tuple(range(8)), tuple(range(4))),)


@dataclass(frozen=True)
class SynthesisSettings:
    """How compensation laws are computed.

    Attributes
    ----------
    algorithm : {"decoupled", "coupled"}
        The paper's Algorithm 2 (two halves of four states) or Algorithm 1 (eight states).
    formulation : {"exact-map", "increment"}
        The exact map of a beat, or the paper's first-order increment (Eq. 4 and 14), which makes the least ``rho``
        small whatever ``size`` says; see :mod:`aerotube.compensation.increment`.
    steps : {"two-step", "three-step"}
        Initial ellipsoid, then law and terminal ellipsoid together (the paper's Algorithms 1 and 2); or the law in a
        shape that is held, then the terminal ellipsoid with the law held (Algorithm 3).
    terminal : {"volume", "trace", "rho"}
        What the third step makes small (exact map), see :mod:`aerotube.compensation.terminal`.
    size : {"mean-square", "worst-case", "trace", "volume"}, or mapping of these to weights
        What is made small: the mean square of the errors to be expected at the end of the beat (see
        :mod:`aerotube.compensation.law_program`), or the least ``rho`` that holds the worst error; or
        the trace of the inverse shape or the volume of the terminal ellipsoid, found together with the law; or a
        mixture, ``{"worst-case": 0.1, "mean-square": 1.0}``. The worst case alone leaves the law free in all
        directions but the worst: it is good for one beat, and flown on it may diverge. Use the mixture.
    shape : {"cost-to-go", "riccati"}
        The metric in which the error at the end of a beat is measured, see :mod:`aerotube.tube.shapes`.
    law_degree : int
        Degree of the law, 1 to 3. The sums of squares get twice that degree at least. On the manoeuvre of Table 2 laws
        of degree 2 and 3 fly better than linear ones, by 0.4 to 4 percent. A coupled law of degree 3 takes seconds to
        find and a minute or two to certify, each beat.
    reuse : int
        Beats for which a law is used again after its own (the paper's Section 3.1): one program serves ``reuse +
        1`` beats. Of the exact map only: the increment form's program has the ellipsoids of one beat.
    saturation : float
        How many times its limits a law may ask for where they must hold, at least 1. Beyond 1 the law cuts itself off
        at its limits, and the cut is in the closed loop that is measured.
    rate_limits : tuple of 4 floats, optional
        Largest rates of the virtual controls, per second. Each law keeps to half of what the limit and the nominal's
        own change leave for one beat, so that the step from one beat's increment to the next one's is within the limit
        whatever the two errors are in the set on which limits hold.
    noise_weight : float
        Mean square of the measurement noise over that of the disturbance set; 1 where both are uniform in the
        same box. It counts in every size of the exact map; the increment form, the paper's,
        knows no noise and leaves it aside.
    limits : {"box", "ellipsoid"}
        On which set the law must keep the controls within their limits: the disturbance box, or the whole
        ellipsoid around it.
    measurement_error : float
        Largest measurement error, as a fraction of the disturbance set, for which the limits must hold too (for
        the ellipsoid, to first order in the attitude), and the tubes beyond their polynomials.
    control_weight : float
        Weight of control effort, in the forecast and in what is made small: ``R = control_weight * diag(1 / half
        range of control^2)``.
    least_expected : float
        Mean square of the errors that come anew at every beat, over that of the disturbance set (of the box around
        it): the law is asked to do something sensible even in directions where no error would be expected. Laws of
        higher degree are told to expect the same share of errors spread over the set besides.
    attitude : {"relative", "euler"}
        Error coordinates the law works in.
    coupling : {"expected", "dropped", "carried"}
        What a half of a decoupled synthesis takes the other half's errors for: what its own errors let expect, see
        :mod:`aerotube.compensation.expectation`; zero, as the paper does; or at their worst, see
        :mod:`aerotube.compensation.carried`. Only the mean square knows what is to be expected; other sizes take
        them for zero then.
    extremes : {"mean", "each"}
        Whether the mean square is that over the extremes of the uncertain parameters, either of which is as likely, or
        one that lies above it at each of them.
    certificate : {"polynomial only", "sampled", "rigorous"}
        What the tubes are to rest on, see :class:`~aerotube.compensation.Tubes`. Rigorous bounds want an aircraft
        with smooth tables: the kinks of linear ones widen them.
    gust, gust_rotation : float
        Largest velocity (m/s) and rotation (rad/s) of the air about each body axis, held over a beat, that the tubes
        must withstand.
    samples, confidence, sample_seed
        Of "sampled" tubes, see :class:`~aerotube.compensation.Sampling`.
    degree : int
        Degree of the sum-of-squares programs, even, at most that of `MOST_DEGREE`.
    backend : {"aerotube", "clarabel"}
        Solver of the programs.

    Raises
    ------
    InputError
        For a value out of range, naming it.
    """

    algorithm: Algorithm = "decoupled"
    formulation: Literal["exact-map", "increment"] = "exact-map"
    steps: Literal["two-step", "three-step"] = "two-step"
    terminal: Literal["volume", "trace", "rho"] = "volume"
    size: Size | Mapping[Size, float] | tuple[tuple[Size, float], ...] = "mean-square"
    shape: Shape = "cost-to-go"
    noise_weight: float = 0.0
    limits: Limits = "box"
    law_degree: int = 1
    reuse: int = 0
    saturation: float = 1.0
    rate_limits: tuple[float, ...] | None = None
    measurement_error: float = 0.0
    control_weight: float = 1e-3
    least_expected: float = 1e-2
    attitude: Literal["relative", "euler"] = "relative"
    coupling: Literal["expected", "dropped", "carried"] = "expected"
    extremes: Literal["mean", "each"] = "mean"
    certificate: Certificate = "sampled"
    gust: float = 0.0
    gust_rotation: float = 0.0
    samples: int = 400
    confidence: float = 0.999
    sample_seed: int = 0
    degree: int = 4
    backend: str = "aerotube"

    def __post_init__(self) -> None:
        choices = {
            "algorithm": ("decoupled", "coupled"),
            "formulation": ("exact-map", "increment"),
            "steps": ("two-step", "three-step"),
            "terminal": ("volume", "trace", "rho"),
            "shape": ("cost-to-go", "riccati"),
            "limits": ("box", "ellipsoid"),
            "attitude": ("relative", "euler"),
            "coupling": ("expected", "dropped", "carried"),
            "extremes": ("mean", "each"),
            "certificate": ("polynomial only", "sampled", "rigorous"),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise InputError(
                    f"synthesis: unknown {name} {getattr(self, name)!r}; choose {' or '.join(map(repr, allowed))}."
                )
        self._check_size()
        if self.law_degree not in (1, 2, 3):
            raise InputError(f"synthesis: law_degree is {self.law_degree}; it must be 1, 2 or 3.")
        self._check_law()
        if self.reuse < 0:
            raise InputError(f"synthesis: reuse is {self.reuse}; it must not be negative.")
        for name in ("noise_weight", "measurement_error", "gust", "gust_rotation"):
            if not getattr(self, name) >= 0:
                raise InputError(f"synthesis: {name} is {getattr(self, name)}; it must not be negative.")
        for name in ("control_weight", "least_expected"):
            if not getattr(self, name) > 0:
                raise InputError(f"synthesis: {name} is {getattr(self, name)}; it must be positive.")
        if self.samples < 100:
            raise InputError(f"synthesis: samples is {self.samples}; it must be at least 100.")
        if not 0 < self.confidence < 1:
            raise InputError(f"synthesis: confidence is {self.confidence}; it must be between 0 and 1.")
        most = MOST_DEGREE[self.algorithm]
        if self.degree < 2 or self.degree % 2 or self.degree > most:
            raise InputError(
                f"synthesis: degree is {self.degree}; it must be even, at least 2, and at most {most} with the "
                f"algorithm {self.algorithm!r} (tubes hardly change beyond 4, and programs take ever longer)."
            )
        try:
            sos.check_backend(self.backend)
        except ValueError as error:
            raise InputError(f"synthesis: {error}") from None

    def _check_law(self) -> None:
        joint = [name for name, _ in self.weights if name in ("trace", "volume")]
        most = 1 if self.algorithm == "coupled" else 2
        if joint and self.law_degree > most:
            raise InputError(
                f"synthesis: the size {joint[0]!r} takes laws of degree {most} at most with the algorithm "
                f"{self.algorithm!r}; law_degree is {self.law_degree}."
            )
        if self.coupling == "carried" and self.law_degree > 1 and "worst-case" not in dict(self.weights):
            raise InputError(
                "synthesis: a law of degree 2 or 3 meets the other half's errors at their worst only where the size is "
                "'worst-case'; choose that, or the coupling 'expected'."
            )
        if self.formulation == "increment" and self.reuse:
            raise InputError(
                "synthesis: the increment form's program is of one beat and cannot share a law with others, which "
                "would each need an initial and a terminal ellipsoid of their own in it; choose reuse = 0, or the "
                "formulation 'exact-map'."
            )
        if not 1.0 <= self.saturation < float("inf"):
            raise InputError(f"synthesis: saturation is {self.saturation}; it must be at least 1.")
        if self.rate_limits is not None:
            object.__setattr__(self, "rate_limits", tuple(float(rate) for rate in self.rate_limits))
            if len(self.rate_limits) != 4 or not all(rate > 0 for rate in self.rate_limits):
                raise InputError(f"synthesis: rate_limits is {self.rate_limits}; give four positive rates.")

    def _check_size(self) -> None:
        given = self.size
        if isinstance(given, Mapping):
            # in one order and hashable, so that equal settings are equal
            given = tuple((name, float(given[name])) for name in sorted(given))
            object.__setattr__(self, "size", given)
        for name, weight in self.weights:
            if name not in SIZES:
                raise InputError(f"synthesis: unknown size {name!r}; choose {' or '.join(map(repr, SIZES))}.")
            if not weight > 0:
                raise InputError(f"synthesis: the weight of the size {name!r} is {weight}; it must be positive.")
        if not self.weights:
            raise InputError(f"synthesis: the mixture of sizes is empty; name one of {', '.join(map(repr, SIZES))}.")

    @property
    def weights(self) -> tuple[tuple[Size, float], ...]:
        """What is made small, and with which weights."""
        if isinstance(self.size, str):
            return ((self.size, 1.0),)
        return tuple(self.size.items()) if isinstance(self.size, Mapping) else self.size

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts the synthesis is split into."""
        return DECOUPLED if self.algorithm == "decoupled" else COUPLED
