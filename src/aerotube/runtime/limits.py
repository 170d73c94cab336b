"""What limits the tracking of a flight: the same manoeuvres with noise and estimator left out or put in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube import flight
from aerotube.compensation import design
from aerotube.flight.metrics import mean_absolute_error, root_mean_square_error

if TYPE_CHECKING:
    from aerotube.runtime.flight import Flown

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
    """Fly the manoeuvres again, laws designed for each condition: without noise, with it, and with the estimator.

    Parameters
    ----------
    flown : Flown

    Returns
    -------
    tuple of Limit
        Empty for a flight of somebody else's aircraft, or along a nominal that was moved in flight. Undelayed, without
        actuators, gusts as they were.
    """
    from aerotube.runtime.flight import make_estimator, make_task

    world, prepared, options = flown.world, flown.prepared, flown.options
    if flown.truth is None or not flown.truth.flown_manoeuvres or options.replan:
        return ()
    draws = world.draws
    if draws.runs > _MOST:
        draws = flight.Draws(
            draws.seeds, _MOST, draws.half_widths, draws.initial_error[:_MOST], draws.parameters[:_MOST]
        )
    noise = world.noise if world.noise > 0 else 1.0
    estimator = make_estimator(prepared, replace(options, estimator=True, noise=noise))
    gusts = world.gusts

    def tracked(law: Any, noise: float, filtered: bool) -> tuple[float, float]:
        found = flight.simulate(
            prepared.plant,
            prepared.nominal,
            law,
            draws,
            noise=noise,
            estimator=estimator if filtered else None,
            gusts=gusts,
            substeps=options.substeps,
        )
        metric = found.metric.reshape(-1)
        return float(mean_absolute_error(metric)), float(root_mean_square_error(metric))

    alone = tracked(None, 0.0, False)
    laws = {}
    for noisy in (False, True):
        task = make_task(prepared, replace(options, estimator=False, noise=noise if noisy else 0.0))
        laws[noisy] = design(task.aircraft, prepared.nominal, task.disturbance, task.settings, workers=task.workers).law
    share = f"sensor noise of {100 * noise:g} % of the disturbance box"
    cases = (
        ("no sensor noise", tracked(laws[False], 0.0, False)),
        (f"{share}, no estimator", tracked(laws[True], noise, False)),
        (f"{share}, estimator", tracked(laws[False], noise, True)),
    )
    return tuple(
        Limit(words, mae, rmse, 1.0 - mae / alone[0], 1.0 - rmse / alone[1])
        for words, (mae, rmse) in cases
        if np.isfinite([mae, rmse]).all()
    )
