"""The sections of a scenario and their keys: types, units, ranges, and what must go together."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from aerotube import inequality
from aerotube.scenario.mistakes import shown
from aerotube.units import parse_quantity, quantity_parser

Speed = Annotated[float, BeforeValidator(quantity_parser("speed"))]
Angle = Annotated[float, BeforeValidator(quantity_parser("angle"))]
Rate = Annotated[float, BeforeValidator(quantity_parser("angular rate"))]
Length = Annotated[float, BeforeValidator(quantity_parser("length"))]
Time = Annotated[float, BeforeValidator(quantity_parser("time"))]
Ratio = Annotated[float, BeforeValidator(quantity_parser("ratio"))]
AngularMomentum = Annotated[float, BeforeValidator(quantity_parser("angular momentum"))]


class _Section(BaseModel):
    # Strict: a quoted number or a 1 for true is a mistake to be named, not to be guessed at.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Aircraft(_Section):
    """What flies, and the model that the laws are computed on."""

    model: str = "f16"
    xcg: float = Field(default=0.30, gt=0.0, lt=1.0)
    engine_momentum: AngularMomentum = 216.931
    engine_lag: bool = False
    interpolation: Literal["linear", "smooth"] = "linear"
    synthesis_interpolation: Literal["linear", "smooth"] = "smooth"


class State(_Section):
    """Initial state of a nominal flown with constant controls (SI)."""

    V: Annotated[Speed, Field(gt=0.0)]
    alpha: Angle
    q: Rate
    theta: Angle
    beta: Angle
    p: Rate
    r: Rate
    phi: Angle
    altitude: Length
    psi: Angle = 0.0


class Control(_Section):
    """Controls of a nominal flown with constant controls (SI)."""

    elevator: Angle
    throttle: float
    aileron: Angle
    rudder: Angle


class Trim(_Section):
    """Level or turning flight for a nominal from trim (SI)."""

    V: Annotated[Speed, Field(gt=0.0)]
    altitude: Length
    turn_rate: Rate = 0.0


class Nominal(_Section):
    """Where the nominal trajectory comes from."""

    source: Literal["constant-controls", "trim", "file"]
    horizon: Annotated[Time, Field(gt=0.0)]
    beat: Annotated[Time, Field(gt=0.0)]
    state: State | None = None
    control: Control | None = None
    trim: Trim | None = None
    file: str | None = None

    @property
    def beats(self) -> int:
        """Number of beats in the horizon."""
        return round(self.horizon / self.beat)

    @model_validator(mode="after")
    def _whole_beats(self) -> Nominal:
        beats = self.horizon / self.beat
        if self.beats < 1 or abs(beats - self.beats) > 1e-9 * beats:
            raise ValueError(
                f"the horizon of {self.horizon:g} s is no whole number of beats of {self.beat:g} s "
                f"({beats:.6g} beats); change the one or the other"
            )
        return self

    @model_validator(mode="after")
    def _source_is_given(self) -> Nominal:
        needs = {"constant-controls": ("state", "control"), "trim": ("trim",), "file": ("file",)}
        for source, keys in needs.items():
            for key in keys:
                given = getattr(self, key) is not None
                if source == self.source and not given:
                    raise ValueError(f'source = "{source}" needs nominal.{key}; add it')
                if source != self.source and given:
                    raise ValueError(f'nominal.{key} belongs to source = "{source}", not to "{self.source}"; remove it')
        return self


#: The errors of the disturbance set, in the order of the error state.
ERRORS = ("V", "alpha", "q", "theta", "beta", "p", "r", "phi")


class Disturbance(_Section):
    """The disturbance set by half-widths (SI), and largest relative changes of uncertain quantities."""

    set: Literal["box", "ellipsoid", "polytope", "semialgebraic"] = "box"
    matrix: list[list[float]] | None = None
    inequalities: list[str] | None = None
    V: Annotated[Speed, Field(gt=0.0)]
    alpha: Annotated[Angle, Field(gt=0.0)]
    q: Annotated[Rate, Field(gt=0.0)]
    theta: Annotated[Angle, Field(gt=0.0)]
    beta: Annotated[Angle, Field(gt=0.0)]
    p: Annotated[Rate, Field(gt=0.0)]
    r: Annotated[Rate, Field(gt=0.0)]
    phi: Annotated[Angle, Field(gt=0.0)]
    mass: Annotated[Ratio, Field(ge=0.0, lt=1.0)] = 0.0
    inertia: Annotated[Ratio, Field(ge=0.0, lt=1.0)] = 0.0
    lift: Annotated[Ratio, Field(ge=0.0, lt=1.0)] = 0.0
    control_effectiveness: Annotated[Ratio, Field(ge=0.0, lt=1.0)] = 0.0

    @property
    def half_widths(self) -> tuple[float, ...]:
        """The eight half-widths in the order of the error state."""
        return (self.V, self.alpha, self.q, self.theta, self.beta, self.p, self.r, self.phi)

    @property
    def terms(self) -> list[dict[tuple[int, ...], float]]:
        """The inequalities as polynomials of errors in units of the half-widths, not negative on the set."""
        return [inequality.parse(text, ERRORS) for text in self.inequalities or ()]

    @field_validator("matrix")
    @classmethod
    def _square(cls, rows: list[list[float]] | None) -> list[list[float]] | None:
        if rows is not None and (len(rows) != 8 or any(len(row) != 8 for row in rows)):
            raise ValueError(f"expected 8 rows of 8 numbers, in the order {', '.join(ERRORS)}")
        return rows

    @field_validator("inequalities")
    @classmethod
    def _readable(cls, texts: list[str] | None) -> list[str] | None:
        for text in texts or ():
            inequality.parse(text, ERRORS)
        return texts

    @model_validator(mode="after")
    def _kind_is_given(self) -> Disturbance:
        cut = self.set in ("polytope", "semialgebraic")
        if cut and not self.inequalities:
            raise ValueError(
                f'set = "{self.set}" needs disturbance.inequalities; add some, such as ["V + alpha <= 1.5"]'
            )
        if self.inequalities is not None and not cut:
            raise ValueError(
                'disturbance.inequalities belong to set = "polytope" or "semialgebraic", not to '
                f'"{self.set}"; remove them'
            )
        if self.matrix is not None and self.set != "ellipsoid":
            raise ValueError(f'disturbance.matrix belongs to set = "ellipsoid", not to "{self.set}"; remove it')
        return self

    @property
    def relative(self) -> dict[str, float]:
        """Largest relative change of each uncertain quantity; the mass is always one, the others where they change."""
        others = ("inertia", "lift", "control_effectiveness")
        return {"mass": self.mass} | {name: getattr(self, name) for name in others if getattr(self, name) > 0.0}


class Draws(_Section):
    """How many random runs, and from which seeds."""

    seeds: int = Field(default=30, ge=1)
    first_seed: int = Field(default=1, ge=0)
    runs: int = Field(default=100, ge=1)

    @property
    def seed_values(self) -> tuple[int, ...]:
        """The seeds themselves."""
        return tuple(range(self.first_seed, self.first_seed + self.seeds))


_SIZES = ("mean-square", "worst-case", "trace", "volume")


def _size(value: Any) -> Any:
    """Check what is to be made small: one of the sizes, or a mixture of them with positive weights."""
    parts = {value: 1.0} if isinstance(value, str) else value
    good = isinstance(parts, dict) and parts and all(name in _SIZES for name in parts)
    if not good or not all(isinstance(w, int | float) and 0 < w < float("inf") for w in parts.values()):
        names = ", ".join(f'"{name}"' for name in _SIZES)
        raise ValueError(
            f"expected one of {names}, or a mixture with positive weights such as "
            f"{{worst-case = 0.1, mean-square = 1.0}}, not {shown(value)}"
        )
    return value


#: The virtual controls that rates are limited of, with what kind of quantity each rate is.
_RATES = {"elevator": "angular rate", "thrust": "rate of thrust", "aileron": "angular rate", "rudder": "angular rate"}


def _rates(value: Any) -> Any:
    """Four rates, each a number in SI or a quantity with its unit."""
    if not isinstance(value, list) or len(value) != len(_RATES):
        raise ValueError(
            f"expected four rates, of {', '.join(_RATES)}, with their units or as numbers in rad/s and N/s, such as "
            f'["60 deg/s", "60000 N/s", "80 deg/s", "120 deg/s"], not {shown(value)}'
        )
    found = []
    for (name, kind), rate in zip(_RATES.items(), value, strict=True):
        number = isinstance(rate, int | float) and not isinstance(rate, bool)
        try:
            found.append(float(rate) if number else parse_quantity(rate, kind))
        except ValueError as error:
            raise ValueError(f"the rate of {name}: {error}") from None
        if not 0.0 < found[-1] < float("inf"):
            raise ValueError(f"the rate of {name} is {shown(rate)}; give a positive one")
    return found


def _even(value: Any) -> Any:
    """A degree of sums of squares."""
    if isinstance(value, int) and not isinstance(value, bool) and (value % 2 or value < 2):
        raise ValueError(f"expected an even number from 2 on, not {value}")
    return value


class Setting(_Section):
    """Keys of the synthesis that one of the two settings may set again; see `SynthesisSettings`."""

    size: Annotated[Any, BeforeValidator(_size)] = None
    shape: Literal["cost-to-go", "riccati"] | None = None
    limits: Literal["box", "ellipsoid"] | None = None
    measurement_error: Annotated[Ratio, Field(ge=0.0)] | None = None
    noise_weight: float | None = Field(default=None, ge=0.0)
    control_weight: float | None = Field(default=None, gt=0.0)
    least_expected: float | None = Field(default=None, gt=0.0)
    attitude: Literal["relative", "euler"] | None = None
    coupling: Literal["expected", "dropped", "carried"] | None = None
    extremes: Literal["mean", "each"] | None = None
    certificate: Literal["polynomial only", "sampled", "rigorous"] | None = None
    gust: Annotated[Speed, Field(ge=0.0)] | None = None
    gust_rotation: Annotated[Rate, Field(ge=0.0)] | None = None
    samples: int | None = Field(default=None, ge=100)
    confidence: Annotated[Ratio, Field(gt=0.0, lt=1.0)] | None = None
    sample_seed: int | None = Field(default=None, ge=0)
    degree: Annotated[int | None, BeforeValidator(_even)] = None
    law_degree: int | None = Field(default=None, ge=1, le=3)
    reuse: int | None = Field(default=None, ge=0)
    formulation: Literal["exact-map", "increment"] | None = None
    steps: Literal["two-step", "three-step"] | None = None
    terminal: Literal["volume", "trace", "rho"] | None = None
    saturation: float | None = Field(default=None, ge=1.0)
    rate_limits: Annotated[list[float] | None, BeforeValidator(_rates)] = None


class Synthesis(Setting):
    """How the laws are computed: common keys, and two settings of them."""

    algorithm: Literal["decoupled", "coupled"] = "decoupled"
    backend: Literal["aerotube", "clarabel"] = "aerotube"
    noise_free: Setting = Setting()
    noise: Setting = Setting()

    def setting(self, name: Literal["noise_free", "noise"]) -> dict[str, Any]:
        """Return the keys of one setting: the common ones, then its own over them."""
        common = self.model_dump(exclude={"noise_free", "noise"}, exclude_none=True)
        own: Setting = getattr(self, name)
        return common | own.model_dump(exclude_none=True)


class Flight(_Section):
    """What the flights add to the initial errors."""

    noise: Annotated[Ratio, Field(ge=0.0)] = 1.0
    estimator: bool = True
    gusts: Literal["none", "light", "moderate", "severe"] = "none"
    substeps: int = Field(default=1, ge=1, le=100)


class Lqr(_Section):
    """The sweep of the baseline."""

    control_weights: list[Annotated[float, Field(gt=0.0)]] = Field(default=[0.001, 0.01, 0.1, 1.0], min_length=1)
    noise_weights: list[Annotated[float, Field(ge=0.0)]] = Field(default=[0.0, 2.0, 4.0, 8.0], min_length=1)
    seeds: int = Field(default=3, ge=1)


class Scenario(_Section):
    """A whole scenario in SI; see `load`."""

    title: str = ""
    aircraft: Aircraft
    nominal: Nominal
    disturbance: Disturbance
    draws: Draws = Draws()
    synthesis: Synthesis = Synthesis()
    flight: Flight = Flight()
    lqr: Lqr = Lqr()
