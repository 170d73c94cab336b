"""The tube at a moment, as a gauge."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from aerotube.commands.common import FAILED, FINE, NOTHING, interruptible
from aerotube.errors import InputError

if TYPE_CHECKING:
    from aerotube.compensation.gauge import Reading
    from aerotube.preparation import Prepared

_STATE = {
    "V": "speed", "alpha": "angle", "q": "angular rate", "theta": "angle", "beta": "angle", "p": "angular rate",
    "r": "angular rate", "phi": "angle", "psi": "angle", "altitude": "length",
}  # fmt: skip
_CONTROL = {"elevator": "angle", "throttle": None, "aileron": "angle", "rudder": "angle"}
_EXAMPLE = '"V=185 m/s, alpha=19.3 deg"'


def tube(
    scenario: Annotated[
        Path | None, typer.Argument(help="A scenario file, as `aerotube init` writes one; Table 2 without it.")
    ] = None,
    time: Annotated[float, typer.Option(metavar="SECONDS", help="Moment of the scenario's manoeuvre.")] = 0.0,
    state: Annotated[
        str, typer.Option(help=f"What is other than at that moment, such as {_EXAMPLE}; also psi and altitude.")
    ] = "",
    control: Annotated[str, typer.Option(help='Controls that are other, such as "throttle=0.8".')] = "",
    disturbance: Annotated[
        str, typer.Option(help='Disturbances that are other than the scenario\'s, such as "V=8 m/s, mass=10 %".')
    ] = "",
    setting: Annotated[str, typer.Option(help="The scenario's setting of the synthesis: noise_free or noise.")] = (
        "noise_free"
    ),
    certificate: Annotated[
        str | None, typer.Option(metavar="KIND", help='"polynomial only", "sampled" or "rigorous".')
    ] = None,
    gains: Annotated[bool, typer.Option("--gains", help="Show the law's gains too.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Write JSON instead of tables.")] = (False),
    figure: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the tube to a file: png, pdf, svg.")] = None,
) -> None:
    """Tell the tube of one beat: where disturbances can take the aircraft, and how much of that a law takes back.

    Half-widths at the start are those of an ellipsoid around the disturbance set, so wider than the scenario's.

    Of a moment of the scenario's manoeuvre the tube is that of `aerotube run`, which knows what follows. With --state
    or --control it is that of the condition alone, in the metric of the stationary regulator there.

    Example: aerotube tube --time 1.5 --state "V=200 m/s" --disturbance "mass=10 %" --gains
    """
    with interruptible(NOTHING):
        from aerotube.preparation import prepare
        from aerotube.scenario import load

        changes = {f"disturbance.{key}": value for key, value in _pairs(disturbance, "--disturbance").items()}
        source = load(scenario, changes)
        if figure is not None:
            _check_figure(figure)
        prepared = prepare(source)
        if setting not in prepared.settings:
            raise InputError(f"--setting {setting} is not known; choose {' or '.join(prepared.settings)}")
        reading, what = _read(prepared, time, state, control, setting, certificate)
        if figure is not None:
            _draw(reading, what, figure, prepared.source.scenario.disturbance.set == "box")
        if as_json:
            typer.echo(json.dumps(described(reading, what, prepared), indent=2))
        else:
            _print(reading, what, prepared, gains)
            if figure is not None:
                typer.echo(f"{figure} written")
    for message in reading.messages:
        typer.echo(f"aerotube: {message}", err=True)
    raise typer.Exit(FINE if reading.feasible.all() and (reading.certificate != "none").all() else FAILED)


def _read(
    prepared: Prepared, time: float, state: str, control: str, setting: str, certificate: str | None
) -> tuple[Reading, str]:
    import numpy as np

    from aerotube.compensation.gauge import gauge, gauge_beat

    nominal, settings = prepared.nominal, prepared.settings[setting]
    if certificate is not None:
        settings = replace(settings, certificate=certificate)  # type: ignore[arg-type]
    beat = int(np.floor(time / nominal.dt + 1e-9)) if np.isfinite(time) else -1
    if not 0 <= beat < nominal.beats:
        raise InputError(
            f"--time {time:g} s is outside the manoeuvre, which is {nominal.beats * nominal.dt:g} s long; choose a "
            "moment within it"
        )
    if not state and not control:
        reading = gauge_beat(prepared.model, nominal, beat, prepared.disturbance, settings)
        return reading, f"beat {beat}, {beat * nominal.dt:g} s into the manoeuvre"
    start = _changed_state(nominal.states[beat], state)
    held = _changed_control(prepared, nominal.controls[beat], control)
    settings = replace(settings, shape="riccati", reuse=0, rate_limits=None)
    reading = gauge(prepared.model, start, held, prepared.disturbance, settings, dt=nominal.dt)
    return reading, "the condition alone, the shape that of the stationary regulator"


def _pairs(text: str, option: str) -> dict[str, str]:
    """The parts of "key=value, key=value"."""
    found: dict[str, str] = {}
    for item in filter(None, (part.strip() for part in text.split(","))):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not key or not value:
            raise InputError(f'{option}: "{item}" is no pair of a name and a value; write for example {_EXAMPLE}')
        if key in found:
            raise InputError(f"{option}: {key} is given twice; give it once")
        found[key] = value
    return found


def _quantities(text: str, option: str, kinds: Mapping[str, str | None]) -> dict[str, float]:
    from aerotube.units import parse_quantity

    found: dict[str, float] = {}
    for key, value in _pairs(text, option).items():
        if key not in kinds:
            raise InputError(f"{option}: there is no {key}; known here: {', '.join(kinds)}")
        kind = kinds[key]
        try:
            found[key] = float(value) if kind is None else parse_quantity(value, kind)
        except ValueError as error:
            why = f'"{value}" is no number' if kind is None else str(error)
            raise InputError(f"{option}: {key}: {why}") from None
    return found


def _changed_state(given: Any, text: str) -> Any:
    """A full state with some quantities set."""
    import numpy as np

    from aerotube.aircraft.rigid_body import velocity_from_flow
    from aerotube.dynamics.errors import ERROR_NAMES
    from aerotube.numerics import euler_from_quaternion, quaternion_from_euler
    from aerotube.preparation import error_states

    values = dict(zip(ERROR_NAMES, error_states(given).tolist(), strict=True))
    values |= {"psi": float(euler_from_quaternion(tuple(given[3:7]))[2]), "altitude": float(given[12])}
    values |= _quantities(text, "--state", _STATE)
    if not values["V"] > 0:
        raise InputError(f"--state: V is {values['V']:g} m/s; give a positive airspeed")
    out = np.array(given, dtype=float)
    out[:3] = velocity_from_flow(values["V"], values["alpha"], values["beta"])
    out[3:7] = quaternion_from_euler(values["phi"], values["theta"], values["psi"])
    out[7:10] = values["p"], values["q"], values["r"]
    out[12] = values["altitude"]
    return out


def _changed_control(prepared: Prepared, given: Any, text: str) -> Any:
    import numpy as np

    from aerotube.units import DISPLAY

    model = prepared.model
    values = dict(zip(model.control_names, given.tolist(), strict=True)) | _quantities(text, "--control", _CONTROL)
    for name, low, high in zip(model.control_names, model.control_lower, model.control_upper, strict=True):
        if not low - 1e-9 <= values[name] <= high + 1e-9:
            unit, factor = DISPLAY[name].unit, DISPLAY[name].factor
            value, least, most = (f"{factor * x + 0.0:g} {unit}".rstrip() for x in (values[name], low, high))
            raise InputError(f"--control: {name} is {value}, beyond its limits of {least} to {most}")
    return np.array([values[name] for name in model.control_names])


def described(reading: Reading, what: str, prepared: Prepared) -> dict[str, Any]:
    """A reading in plain numbers, in the units in which they are shown; None for what there is not."""
    import numpy as np

    from aerotube.dynamics.errors import ERROR_NAMES
    from aerotube.units import DISPLAY

    def number(value: Any) -> float | None:
        return float(value) if np.isfinite(value) else None

    states = {}
    kinds = ("half_widths_initial", "half_widths_nominal", "half_widths")
    for i, name in enumerate(ERROR_NAMES):
        start, without, with_law = (number(DISPLAY[name].factor * getattr(reading, kind)[i]) for kind in kinds)
        states[name] = {"unit": DISPLAY[name].unit, "start": start, "nominal": without, "compensated": with_law}
    parts = {
        name: {
            "size_nominal": number(reading.size_nominal[i]),
            "size": number(reading.size[i]),
            "ratio": number(reading.ratio[i]),
            "certificate": str(reading.certificate[i]),
            "feasible": bool(reading.feasible[i]),
        }
        for i, name in enumerate(reading.parts)
    }
    virtual = zip(prepared.model.virtual_names, prepared.model.virtual_units, reading.gains, strict=True)
    per_state = np.array([DISPLAY[name].factor for name in ERROR_NAMES])
    gains = {
        name: {"unit": "deg" if unit == "rad" else unit}
        | dict(zip(ERROR_NAMES, ((np.degrees(1.0) if unit == "rad" else 1.0) * row / per_state).tolist(), strict=True))
        for name, unit, row in virtual
    }
    return {
        "what": what,
        "beat_s": prepared.nominal.dt,
        "half_widths": states,
        "parts": parts,
        "gains": gains,
        "messages": list(reading.messages),
    }


def _print(reading: Reading, what: str, prepared: Prepared, gains: bool) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    console, told = Console(highlight=False), described(reading, what, prepared)

    def shown(value: float | None, digits: int = 4) -> str:
        return "–" if value is None else f"{value:.{digits}g}"

    table = Table(
        title=f"Errors, half-widths ({what}; {1e3 * told['beat_s']:g} ms)", title_justify="left", box=SIMPLE_HEAD
    )
    for heading in ("", "unit", "at the start", "at the end, nominal controls", "with the law"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for name, row in told["half_widths"].items():
        table.add_row(name, row["unit"], *(shown(row[key]) for key in ("start", "nominal", "compensated")))
    console.print(table)
    console.print(tube_words(reading.parts, prepared.source.scenario.disturbance.set == "box"), soft_wrap=True)
    table = Table(title="Size of the tube, in the metric of the synthesis", title_justify="left", box=SIMPLE_HEAD)
    for heading in ("", "nominal controls", "with the law", "ratio", "certificate"):
        table.add_column(heading, justify="left" if heading in ("", "certificate") else "right")
    for name, row in told["parts"].items():
        table.add_row(name, shown(row["size_nominal"]), shown(row["size"]), shown(row["ratio"], 3), row["certificate"])
    console.print(table)
    if gains:
        table = Table(title="Gains of the law, per unit of each error", title_justify="left", box=SIMPLE_HEAD)
        for heading in ("", "unit", *(f"{name} ({row['unit']})" for name, row in told["gains"].items())):
            table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
        for name, row in told["half_widths"].items():
            values = [gain[name] for gain in told["gains"].values()]
            table.add_row(name, row["unit"], *(f"{value:.4g}" if value else "·" for value in values))
        console.print(table)


def _check_figure(file: Path) -> None:
    """Notice before anything is computed that a figure cannot be written."""
    from matplotlib.backend_bases import FigureCanvasBase

    known = FigureCanvasBase.get_supported_filetypes()
    if file.suffix[1:].lower() not in known:
        raise InputError(
            f"--figure {file}: its ending is not one of those there are; choose {', '.join(sorted(known))}"
        )
    if file.is_dir():
        raise InputError(f"--figure {file} is a folder; add a file's name")
    try:
        with tempfile.NamedTemporaryFile(dir=file.parent, prefix=".write-test-"):
            pass
    except OSError as error:
        raise InputError(f"--figure {file} cannot be written ({error.strerror}); choose another place") from None


def tube_words(parts: Sequence[str], box: bool) -> str:
    """How the half-widths of a tube are to be read."""
    states = 8 // len(parts)
    start = (
        f"the least ellipsoid around the disturbance box, up to √{states} = {states**0.5:.3g} times as wide"
        if box
        else "the least ellipsoid around the disturbance set, wider than it"
    )
    return (
        f"The tube starts from {start}. The law makes the size in the metric of cost small, not each half-width: "
        "single ones may grow while the ratio of sizes shrinks."
    )


def _draw(reading: Reading, what: str, file: Path, box: bool) -> None:
    """The tube projected on the pairs of states of the paper's Fig. 8."""
    import numpy as np

    from aerotube.dynamics.errors import ERROR_NAMES
    from aerotube.report.style import COLOURS, DASHES, new_figure, tidy
    from aerotube.report.tubes import PAIRS
    from aerotube.results import whole_file
    from aerotube.tube import ellipsoid
    from aerotube.units import DISPLAY

    tubes = reading.tubes
    assert tubes is not None
    kinds = (
        ("initial", "nominal", "at the start"),
        ("nominal", "none", "nominal controls"),
        ("terminal", "compensated", "with the law"),
    )
    picture = new_figure(8.0, 7.4, f"Errors over one beat: {what}")
    sentences = tube_words(reading.parts, box).split(". ")
    picture.text(0.5, 0.015, ".\n".join(sentences), ha="center", fontsize=7.5, color="#555555")
    for place, pair in enumerate(PAIRS):
        axes = picture.add_axes((0.09 + 0.49 * (place % 2), 0.58 - 0.455 * (place // 2), 0.39, 0.335))
        index, own = next(
            (i, part.errors)
            for i, part in enumerate(tubes.parts)
            if {ERROR_NAMES.index(name) for name in pair} <= set(part.errors)
        )
        axis = tuple(own.index(ERROR_NAMES.index(name)) for name in pair)
        factors = np.array([DISPLAY[name].factor for name in pair])
        for which, colour, words in kinds:
            shape, rho = getattr(tubes, f"{which}_shape")[0, index], getattr(tubes, f"{which}_rho")[0, index]
            if not np.isfinite(rho):
                continue
            edge = factors * ellipsoid.boundary(ellipsoid.projection(shape, axis), rho, 181)
            axes.plot(*edge.T, color=COLOURS[colour], linestyle=DASHES[colour], linewidth=1.6, label=words)
        tidy(axes, DISPLAY[pair[1]].label, time=False)
        axes.set_xlabel(DISPLAY[pair[0]].label, fontsize=9)
        if place == 0:
            picture.legend(
                *axes.get_legend_handles_labels(),
                loc="upper center",
                bbox_to_anchor=(0.5, 0.965),
                ncols=3,
                fontsize=9,
                frameon=False,
            )
    with whole_file(file) as aside:
        picture.savefig(aside, dpi=150, format=file.suffix[1:].lower())
