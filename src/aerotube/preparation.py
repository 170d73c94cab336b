"""What a scenario names, made and checked: aircraft, nominal trajectory, disturbance, draws, settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from aerotube import compensation, flight, nominal, scenario
from aerotube.aircraft import Aircraft, make
from aerotube.aircraft.rigid_body import flow_angles, velocity_from_flow
from aerotube.errors import InputError
from aerotube.numerics import euler_from_quaternion, quaternion_from_euler
from aerotube.results import CALM, ESTIMATOR, NOISE
from aerotube.tube import DisturbanceSet, disturbance_set
from aerotube.units import DISPLAY

Array = NDArray[np.float64]

#: The settings of the synthesis that a scenario has.
SETTINGS: tuple[Literal["noise_free", "noise"], ...] = ("noise_free", "noise")


@dataclass(frozen=True)
class Prepared:
    """Everything that a scenario names, made and checked.

    Attributes
    ----------
    source : scenario.Source
    plant : Aircraft
        The aircraft that flies.
    rigid : Aircraft
        The same without engine lag: of the nominal and of the estimator, which would take any other reading of
        the tables for an error of the measurement.
    model : Aircraft
        What the laws are computed on.
    nominal : nominal.Nominal
    disturbance : DisturbanceSet
    draws : flight.Draws
        Of all seeds.
    settings : dict of SynthesisSettings
        By name, "noise_free" and "noise".
    gusts : flight.Dryden or None
    """

    source: scenario.Source
    plant: Aircraft
    rigid: Aircraft
    model: Aircraft
    nominal: nominal.Nominal
    disturbance: DisturbanceSet
    draws: flight.Draws
    settings: dict[str, compensation.SynthesisSettings]
    gusts: flight.Dryden | None

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions that the scenario asks for."""
        wanted = self.source.scenario.flight
        noisy = (NOISE, *((ESTIMATOR,) if wanted.estimator else ())) if wanted.noise > 0 else ()
        return (CALM, *noisy)


def prepare(source: scenario.Source) -> Prepared:
    """Make and check everything that a scenario names; nothing is computed yet that can fail otherwise.

    Parameters
    ----------
    source : scenario.Source

    Returns
    -------
    Prepared

    Raises
    ------
    InputError
        If the scenario cannot be flown as it stands: a nominal outside the aircraft's model, controls beyond
        their limits, an option out of range.
    """
    chosen = source.scenario
    common: dict[str, Any] = {"xcg": chosen.aircraft.xcg, "engine_momentum": chosen.aircraft.engine_momentum}
    name, published = chosen.aircraft.model, chosen.aircraft.interpolation
    relative = chosen.disturbance.relative
    if len(relative) > 1:
        common["uncertain"] = tuple(relative)
    rigid = make(name, interpolation=published, **common)
    plant = make(name, interpolation=published, engine_lag=True, **common) if chosen.aircraft.engine_lag else rigid
    model = make(name, interpolation=chosen.aircraft.synthesis_interpolation, **common)
    reference = make_nominal(source, rigid)
    reference.check(rigid)
    reference.check(model)
    errors = disturbance_set(
        chosen.disturbance.set,
        chosen.disturbance.half_widths,
        relative,
        matrix=chosen.disturbance.matrix,
        inequalities=chosen.disturbance.terms,
        texts=chosen.disturbance.inequalities or (),
    )
    draws = flight.draw(
        errors.half_widths,
        chosen.draws.seed_values,
        chosen.draws.runs,
        initial=None if chosen.disturbance.set == "box" else errors.sample,
        **drawn_parameters(chosen.disturbance, rigid),
    )
    for key in SETTINGS:
        reuse = chosen.synthesis.setting(key).get("reuse", 0)
        if reuse >= reference.beats:
            raise InputError(
                f"synthesis.reuse is {reuse}: a law would be used again for {reuse} beats after its own, and the "
                f"nominal has {reference.beats} in all; choose at most {reference.beats - 1}"
            )
    settings: dict[str, compensation.SynthesisSettings] = {
        key: compensation.SynthesisSettings(**chosen.synthesis.setting(key)) for key in SETTINGS
    }
    return Prepared(source, plant, rigid, model, reference, errors, draws, settings, _gusts(source, reference))


def _gusts(source: scenario.Source, reference: nominal.Nominal) -> flight.Dryden | None:
    severity = source.scenario.flight.gusts
    if severity == "none":
        return None
    from aerotube.aircraft.f16_aerodynamics import SPAN

    start = reference.states[0]
    return flight.Dryden(severity, float(start[12]), float(np.linalg.norm(start[:3])), SPAN)


def drawn_parameters(disturbance: scenario.Disturbance, aircraft: Aircraft, share: float = 1.0) -> dict[str, Any]:
    """Options of `aerotube.flight.draw` for a scenario's uncertain quantities, `share` of their ranges."""
    mass, *others = (share * change for change in disturbance.relative.values())
    return {
        "mass_error": mass,
        "other_parameters": [(1.0 - change, 1.0 + change) for change in others],
        "inverse": [i for i, name in enumerate(aircraft.parameter_names) if name.startswith("inverse_")],
    }


def estimated_parameters(disturbance: scenario.Disturbance) -> dict[str, Any]:
    """Options of `aerotube.flight.extended_kalman_filter` for a scenario's uncertain quantities."""
    mass, *others = disturbance.relative.values()
    return {"mass_error": mass, "other_parameters": [(-change, change) for change in others]}


def make_nominal(source: scenario.Source, aircraft: Aircraft) -> nominal.Nominal:
    """Make the nominal trajectory of a scenario.

    Parameters
    ----------
    source : scenario.Source
    aircraft : Aircraft
        Of thirteen states.

    Returns
    -------
    nominal.Nominal

    Raises
    ------
    InputError
        If the initial state or the controls are outside the aircraft's model, or the file does not fit.
    """
    wanted = source.scenario.nominal
    if wanted.source == "file":
        assert wanted.file is not None  # seen to by the scenario
        return _cut(nominal.read(source.folder / wanted.file, aircraft), wanted, wanted.file)
    if wanted.source == "trim":
        assert wanted.trim is not None
        trim = wanted.trim
        return nominal.from_trim(aircraft, trim.V, trim.altitude, trim.turn_rate, dt=wanted.beat, beats=wanted.beats)
    assert wanted.state is not None
    assert wanted.control is not None
    control = np.array([getattr(wanted.control, name) for name in aircraft.control_names])
    _check_controls(aircraft, control)
    return nominal.constant_controls(aircraft, full_state(wanted.state), control, wanted.beat, wanted.beats)


def _check_controls(aircraft: Aircraft, control: Array) -> None:
    """Name a control beyond its limits by its key and in its unit of the scenario."""
    tolerance = 1e-9
    for i, name in enumerate(aircraft.control_names):
        low, high = aircraft.control_lower[i], aircraft.control_upper[i]
        if not low - tolerance <= control[i] <= high + tolerance:
            display = DISPLAY[name]
            # Adding zero turns the limit -0 into 0.
            value, least, most = (display.factor * x + 0.0 for x in (control[i], low, high))
            raise InputError(
                f"nominal.control.{name} is {value:g} {display.unit}".rstrip()
                + f", beyond its limits of {least:g} to {most:g} {display.unit}".rstrip()
                + "; choose a value within them"
            )


def _cut(given: nominal.Nominal, wanted: scenario.Nominal, name: str) -> nominal.Nominal:
    """The first beats of a nominal from a file."""
    if not np.isclose(given.dt, wanted.beat, rtol=1e-6):
        raise InputError(
            f"nominal.file {name} has beats of {given.dt:g} s, nominal.beat is {wanted.beat:g} s; agree them"
        )
    if given.beats < wanted.beats:
        raise InputError(
            f"nominal.file {name} is {given.beats * given.dt:g} s long, nominal.horizon is {wanted.horizon:g} s; "
            "shorten the horizon"
        )
    return nominal.Nominal(given.dt, given.states[: wanted.beats + 1], given.controls[: wanted.beats], given.source)


def full_state(start: scenario.State) -> Array:
    """Full state of a scenario's initial state: ndarray (13,)."""
    velocity = velocity_from_flow(start.V, start.alpha, start.beta)
    attitude = quaternion_from_euler(start.phi, start.theta, start.psi)
    return np.array([*velocity, *attitude, start.p, start.q, start.r, 0.0, 0.0, start.altitude], dtype=float)


def error_states(states: Array) -> Array:
    """Full states in the eight quantities of the error state, SI: ndarray (..., 8)."""
    airspeed, attack, sideslip = flow_angles((states[..., 0], states[..., 1], states[..., 2]))
    roll, pitch, _ = euler_from_quaternion(tuple(states[..., i] for i in range(3, 7)))
    p, q, r = (states[..., i] for i in (7, 8, 9))
    return np.stack([airspeed, attack, q, pitch, sideslip, p, r, roll], axis=-1)


def coefficient_curves(aircraft: Aircraft) -> tuple[Array | None, dict[str, Array]]:
    """Aerodynamic coefficients over angle of attack, as in the paper's Fig. 7.

    Parameters
    ----------
    aircraft : Aircraft

    Returns
    -------
    alpha : ndarray or None
        rad, -10 to 25 degrees; None for an aircraft that has no such tables.
    curves : dict of ndarray
        CD, CL, Cm at no sideslip and CY, Cl, Cn at 5 degrees of it; rates and deflections zero.
    """
    from aerotube.aircraft import F16
    from aerotube.aircraft.f16_aerodynamics import coefficients

    if not isinstance(aircraft, F16):
        return None, {}
    alpha = np.radians(np.linspace(-10.0, 25.0, 141))
    zero = np.zeros_like(alpha)

    def at(sideslip: float) -> tuple[Any, ...]:
        flow = (zero + 150.0, alpha, zero + sideslip)  # without rates the airspeed does not matter
        airframe = aircraft.airframe
        return coefficients(airframe.aerodynamics, flow, (zero,) * 3, (zero,) * 4, airframe.lever)

    cx, _, cz, _, cm, _ = at(0.0)
    _, cy, _, cl, _, cn = at(np.radians(5.0))
    drag, lift = -cx * np.cos(alpha) - cz * np.sin(alpha), cx * np.sin(alpha) - cz * np.cos(alpha)
    return alpha, {"CD": drag, "CL": lift, "Cm": cm, "CY": cy, "Cl": cl, "Cn": cn}
