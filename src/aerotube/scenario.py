"""Scenarios: what to fly, in a validated TOML file, and the objects that it names."""

from __future__ import annotations

import difflib
import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator, model_validator

from aerotube import inequality
from aerotube.errors import InputError
from aerotube.units import quantity_parser

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
            f"{{worst-case = 1.0, mean-square = 0.1}}, not {_shown(value)}"
        )
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
    degree: int | None = Field(default=None, ge=2, multiple_of=2)
    law_degree: int | None = Field(default=None, ge=1, le=3)
    reuse: int | None = Field(default=None, ge=0)
    formulation: Literal["exact-map", "increment"] | None = None
    steps: Literal["two-step", "three-step"] | None = None
    terminal: Literal["volume", "trace", "rho"] | None = None
    saturation: float | None = Field(default=None, ge=1.0)
    rate_limits: list[Annotated[float, Field(gt=0.0)]] | None = Field(default=None, min_length=4, max_length=4)


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


@dataclass(frozen=True)
class Source:
    """A scenario with the text that it came from.

    Attributes
    ----------
    scenario : Scenario
    name : str
        Name of the file, or "built-in".
    text : str
        The TOML text, without the overrides.
    overrides : dict
        Keys (dotted) that were set over the text, with their values as written.
    folder : Path
        What relative paths in the scenario are relative to.
    """

    scenario: Scenario
    name: str
    text: str
    overrides: dict[str, Any]
    folder: Path

    @property
    def sha256(self) -> str:
        """Hash of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def built_in_text(name: str = "table2") -> str:
    """Return the TOML text of a built-in scenario, comments included."""
    return resources.files("aerotube").joinpath("scenarios", f"{name}.toml").read_text(encoding="utf-8")


def load(path: str | Path | None = None, overrides: Mapping[str, Any] | None = None) -> Source:
    """Read and validate a scenario.

    Parameters
    ----------
    path : str or Path, optional
        A TOML file; the built-in scenario (Table 2) without it.
    overrides : mapping, optional
        Dotted keys with values as they would be written in the file, set over the text.

    Returns
    -------
    Source

    Raises
    ------
    InputError
        If the file is missing or no TOML, or a key is unknown, missing, of the wrong type or unit, or
        out of range.
    """
    if path is None:
        name, folder, text = "built-in", Path.cwd(), built_in_text()
    else:
        file = Path(path)
        name, folder = str(path), file.resolve().parent
        try:
            text = file.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise InputError(f"scenario {name}: no such file; `aerotube init FILE` writes one to start from") from None
        except UnicodeDecodeError:
            raise InputError(f"scenario {name} is not text in UTF-8") from None
        except OSError as error:
            raise InputError(f"scenario {name} cannot be read: {error.strerror}") from None
    return parse(text, name=name, folder=folder, overrides=overrides)


def parse(
    text: str,
    *,
    name: str = "scenario",
    folder: Path | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Source:
    """Validate the TOML text of a scenario; see `load`."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"scenario {name} is not valid TOML: {error}") from None
    chosen = dict(overrides or {})
    for key, value in chosen.items():
        _set(document, key.split("."), value)
    try:
        scenario = Scenario.model_validate(document)
    except ValidationError as error:
        raise InputError(f"scenario {name}: {_sentence(error, chosen)}") from None
    return Source(scenario, name, text, chosen, folder or Path.cwd())


def _set(document: dict[str, Any], keys: list[str], value: Any) -> None:
    for key in keys[:-1]:
        inner = document.setdefault(key, {})
        if not isinstance(inner, dict):
            return  # the validation below names the misplaced key
        document = inner
    document[keys[-1]] = value


_EXPECTED = {
    "float_type": "a number without quotes",
    "int_type": "a whole number without quotes",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text in quotes",
    "list_type": "a list in brackets",
    "too_short": "a list of at least one value",
    "finite_number": "a finite number",
    "model_type": "a table",
    "model_attributes_type": "a table",
}


def _sentence(error: ValidationError, overrides: Mapping[str, Any]) -> str:
    """Turn the first problem into one sentence: where, what, and what to do."""
    # An unknown key explains a missing one better than the other way round.
    problems = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = problems[0]
    place = ".".join(str(part) for part in first["loc"])
    kind, given = first["type"], first["input"]
    context = first.get("ctx", {})
    if kind == "extra_forbidden":
        known = _known_keys(first["loc"][:-1])
        close = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
        hint = f'did you mean "{close[0]}"?' if close else f"known here: {', '.join(known)}"
        sentence = f"{place} is an unknown key; {hint}"
    elif kind == "missing":
        sentence = f"{place} is missing; add it"
    elif kind in _EXPECTED:
        sentence = f"{place} must be {_EXPECTED[kind]}, not {_shown(given)}"
    elif kind == "literal_error":
        sentence = f"{place} must be {context['expected']}, not {_shown(given)}"
    elif kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        words = kind.replace("_than", " than").replace("_equal", " or equal to")
        (bound,) = context.values()
        sentence = f"{place} must be {words} {bound:g}, not {_shown(given)}"
    elif kind == "value_error":
        message = str(context["error"])
        sentence = message if len(first["loc"]) <= 1 else f"{place}: {message}"
    else:
        sentence = f"{place}: {first['msg']} (given: {_shown(given)})"
    if place in overrides:
        sentence += " (set by a command-line option)"
    if len(problems) > 1:
        sentence += f" (and {len(problems) - 1} more)"
    return sentence


def _shown(value: Any) -> str:
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _known_keys(location: tuple[int | str, ...]) -> list[str]:
    model: Any = Scenario
    for part in location:
        annotation = model.model_fields[str(part)].annotation
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next(c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel))
    return list(model.model_fields)
