"""What a search that tried to break tubes has found: labelled, and in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube.flight import FORMS
from aerotube.results.record import STATE_UNITS, STATES
from aerotube.units import DISPLAY
from aerotube.verify import PROMISING, Falsification

if TYPE_CHECKING:
    import xarray as xr

FORM_WORDS = {"size": "size in the metric", "ellipsoid": "terminal ellipsoid"}
_DEGREES = float(np.degrees(1.0))
_WIND = (
    ("u", "m/s", 1.0),
    ("v", "m/s", 1.0),
    ("w", "m/s", 1.0),
    ("p", "deg/s", _DEGREES),
    ("q", "deg/s", _DEGREES),
    ("r", "deg/s", _DEGREES),
)


@dataclass(frozen=True)
class Attack:
    """An attack on the tubes of one law.

    Attributes
    ----------
    found : Falsification
    certificate : ndarray (T, parts) of str
        What stands behind each tube.
    parameter_names : tuple of str
        Of the aircraft that flew.
    """

    found: Falsification
    certificate: NDArray[np.str_]
    parameter_names: tuple[str, ...]

    @property
    def refuted(self) -> NDArray[np.bool_]:
        """Broken tubes that promise more than their polynomials: ndarray (T, parts, 2)."""
        return np.asarray(self.found.broken & np.isin(self.certificate, PROMISING)[..., None])


def attack_dataset(attacks: Mapping[str, Attack], attributes: Mapping[str, Any]) -> xr.Dataset:
    """Label attacks on the tubes of several laws of one scenario, of the same parts.

    Parameters
    ----------
    attacks : mapping of str to Attack
        By law.
    attributes : mapping
        Of the dataset.

    Returns
    -------
    xarray.Dataset
        SI units.
    """
    import xarray as xr

    first = next(iter(attacks.values()))

    def stacked(name: str) -> Any:
        return np.stack([getattr(attack.found, name) for attack in attacks.values()])

    dims = ("law", "beat", "part", "form")
    worst = "of the worst point found"
    by_state = {"units": ", ".join(STATE_UNITS)}
    return xr.Dataset(
        {
            "ratio": (dims, stacked("ratio"), {"units": "1", "long_name": "largest size found over the tube's"}),
            "error": ((*dims, "state"), stacked("error"), by_state | {"long_name": f"error at the start, {worst}"}),
            "measurement_error": (
                (*dims, "state"),
                stacked("measurement_error"),
                by_state | {"long_name": f"measurement error, {worst}"},
            ),
            "parameters": ((*dims, "parameter"), stacked("parameters"), {"units": "1", "long_name": worst}),
            "wind": (
                (*dims, "axis"),
                stacked("wind"),
                {"units": "m/s, m/s, m/s, rad/s, rad/s, rad/s", "long_name": f"wind, {worst}"},
            ),
            "certificate": (("law", "beat", "part"), np.stack([attack.certificate for attack in attacks.values()])),
        },
        coords={
            "law": list(attacks),
            "part": list(first.found.parts),
            "form": list(FORMS),
            "state": list(STATES),
            "parameter": list(first.parameter_names),
            "axis": [name for name, _, _ in _WIND[:3]] + [f"rotation {name}" for name, _, _ in _WIND[3:]],
        },
        attrs=dict(attributes)
        | {
            "title": "aerotube falsification: the worst that was found against each tube",
            "samples": first.found.samples,
            "seed": first.found.seed,
            "interrupted": int(any(attack.found.interrupted for attack in attacks.values())),
        },
    )


def summarise_attack(attack: Attack) -> list[dict[str, Any]]:
    """Tightness of one law's tubes, a row for each part, form and kind of certificate.

    Returns
    -------
    list of dict
        ``part``, ``form``, ``certificate``, ``tubes`` (attacked), ``median``, ``min`` and ``max`` of the ratio of the
        worst found to the bound, ``broken`` (tubes).
    """
    rows = []
    for i, part in enumerate(attack.found.parts):
        for k, form in enumerate(FORMS):
            for kind in dict.fromkeys(attack.certificate[:, i].tolist()):
                ratio = attack.found.ratio[attack.certificate[:, i] == kind, i, k]
                ratio = ratio[~np.isnan(ratio)]
                if not len(ratio):
                    continue
                low, middle, high = (float(f(ratio)) for f in (np.min, np.median, np.max))
                broken = int((attack.found.broken[:, i, k] & (attack.certificate[:, i] == kind)).sum())
                rows.append(
                    {
                        "part": part,
                        "form": form,
                        "certificate": str(kind),
                        "tubes": len(ratio),
                        "median": _number(middle),
                        "min": _number(low),
                        "max": _number(high),
                        "broken": broken,
                    }
                )
    return rows


def violations(attack: Attack) -> list[dict[str, Any]]:
    """Broken tubes, those that promise more first, the worst first.

    Returns
    -------
    list of dict
        ``beat``, ``part``, ``form``, ``ratio``, ``certificate``, and ``point`` in words.
    """
    places = [tuple(int(i) for i in place) for place in np.argwhere(attack.found.broken)]
    places.sort(key=lambda place: (not attack.refuted[place], -attack.found.ratio[place]))
    return [
        {
            "beat": beat,
            "part": attack.found.parts[part],
            "form": FORMS[form],
            "ratio": _number(float(attack.found.ratio[beat, part, form])),
            "certificate": str(attack.certificate[beat, part]),
            "point": point_words(attack, beat, part, form),
        }
        for beat, part, form in places
    ]


def point_words(attack: Attack, beat: int, part: int, form: int) -> str:
    """The worst point found against a tube, in an engineer's units.

    Parameters
    ----------
    attack : Attack
    beat, part, form : int

    Returns
    -------
    str
        Such as ``errors V +4.2 m/s, α -0.31 deg; mass +5 %``; what is zero is left out.
    """
    at, found = (beat, part, form), attack.found
    groups = [
        ("errors", _state_words(found.error[at])),
        ("", _parameter_words(found.parameters[at], attack.parameter_names)),
        ("measured with errors", _state_words(found.measurement_error[at])),
        (
            "wind",
            [
                f"{name} {factor * value:+.3g} {unit}"
                for (name, unit, factor), value in zip(_WIND, found.wind[at], strict=True)
                if value
            ],
        ),
    ]
    return "; ".join(f"{name} {', '.join(words)}".strip() for name, words in groups if words)


def _state_words(values: NDArray[np.float64]) -> list[str]:
    shown = [(DISPLAY[name], value) for name, value in zip(STATES, values, strict=True) if value]
    return [f"{display.symbol} {display.factor * value:+.3g} {display.unit}" for display, value in shown]


def _parameter_words(values: NDArray[np.float64], names: tuple[str, ...]) -> list[str]:
    words = []
    for name, value in zip(names, values, strict=True):
        change = 1.0 / value - 1.0 if name.startswith("inverse_") else value - 1.0
        words.append(f"{name.removeprefix('inverse_').replace('_', ' ')} {100.0 * change:+.3g} %")
    return words


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
