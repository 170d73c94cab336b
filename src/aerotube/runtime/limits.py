"""What limits the tracking of a flight: the same manoeuvres with less and less noise, estimator off and on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube import flight
from aerotube.compensation import design
from aerotube.flight.metrics import mean_absolute_error, root_mean_square_error

if TYPE_CHECKING:
    from aerotube.runtime.flight import Flown

_SHARES = (1.0, 0.5, 0.25, 0.125)  # of the flight's noise
_MOST = 50  # manoeuvres that are flown again


@dataclass(frozen=True)
class Limit:
    """Tracking of the flight's manoeuvres in one condition.

    Attributes
    ----------
    condition : str
        In words.
    mae, rmse : float
        Of Eq. 18, with compensation.
    mae_reduction, rmse_reduction : float
        One minus the ratio to the same without compensation.
    """

    condition: str
    mae: float
    rmse: float
    mae_reduction: float
    rmse_reduction: float


def what_limits(flown: Flown) -> tuple[Limit, ...]:
    """Fly the manoeuvres again, laws designed for each condition: with the flight's noise, with less, and with none.

    Parameters
    ----------
    flown : Flown

    Returns
    -------
    tuple of Limit
        Empty for a flight of somebody else's aircraft, or along a nominal that was moved in flight. Undelayed, without
        actuators, gusts as they were.
    """
    from aerotube.runtime.options import make_estimator, make_task

    world, prepared, options = flown.world, flown.prepared, flown.options
    if flown.truth is None or not flown.truth.flown_manoeuvres or options.replan:
        return ()
    draws = world.draws
    if draws.runs > _MOST:
        draws = flight.Draws(
            draws.seeds, _MOST, draws.half_widths, draws.initial_error[:_MOST], draws.parameters[:_MOST]
        )
    noise = world.noise if world.noise > 0 else 1.0

    def tracked(law: Any, noise: float, filtered: bool) -> tuple[float, float]:
        estimator = make_estimator(prepared, replace(options, estimator=True, noise=noise)) if filtered else None
        found = flight.simulate(
            prepared.plant,
            prepared.nominal,
            law,
            draws,
            noise=noise,
            estimator=estimator,
            gusts=world.gusts,
            substeps=options.substeps,
        )
        metric = found.metric.reshape(-1)
        return float(mean_absolute_error(metric)), float(root_mean_square_error(metric))

    def designed(share: float) -> Any:
        task = make_task(prepared, replace(options, estimator=False, noise=share * noise))
        settings = task.settings
        if share:
            # the noise's mean square goes with the square of its size
            weight, error = share**2 * settings.noise_weight, share * settings.measurement_error
            settings = replace(settings, noise_weight=weight, measurement_error=error)
        return design(task.aircraft, prepared.nominal, task.disturbance, settings, workers=task.workers).law

    alone, exact = tracked(None, 0.0, False), designed(0.0)
    cases = [("no sensor noise", tracked(exact, 0.0, False))]
    for share in _SHARES:
        words = f"sensor noise of {100 * share * noise:g} % of the disturbance box"
        cases.append((f"{words}, no estimator", tracked(designed(share), share * noise, False)))
        cases.append((f"{words}, estimator", tracked(exact, share * noise, True)))
    return tuple(
        Limit(words, mae, rmse, 1.0 - mae / alone[0], 1.0 - rmse / alone[1])
        for words, (mae, rmse) in cases
        if np.isfinite([mae, rmse]).all()
    )
