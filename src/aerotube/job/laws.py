"""The laws of a run and their tubes, as its record keeps them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aerotube import compensation, verify
from aerotube.preparation import Prepared
from aerotube.results import Law, Record


def design(
    prepared: Prepared,
    record: Record,
    key: Literal["noise_free", "noise"],
    laws: dict[str, compensation.Compensation],
    workers: int,
    tell: Callable[[float], None],
) -> None:
    """Compute the law of a setting and its tubes, and put them into the record, with what failed.

    Parameters
    ----------
    prepared : Prepared
    record : Record
    key : {"noise_free", "noise"}
        The setting.
    laws : dict
        Gets the law.
    workers : int
        Threads that solve.
    tell : callable
        Told which share of it is done.
    """
    made = compensation.synthesise(
        prepared.model,
        prepared.nominal,
        prepared.disturbance,
        prepared.settings[key],
        workers=workers,
        progress=lambda done, total: tell(done / total),
    )
    laws[key] = made
    record.laws[key] = _recorded(prepared, key, made)
    record.problems.extend(f"{key.replace('_', '-')} law, {message}" for message in made.messages)
    for index, part in enumerate(made.tubes.parts):
        sizes = np.stack([made.tubes.terminal_rho[:, index], made.tubes.nominal_rho[:, index]])
        unknown = np.flatnonzero(~np.isfinite(sizes).all(axis=0))
        if unknown.size:
            record.problems.append(
                f"{key.replace('_', '-')} law, {part.name}: no tube was found at beat {ranges(unknown)}"
            )


def _recorded(prepared: Prepared, key: Literal["noise_free", "noise"], made: compensation.Compensation) -> Law:
    tubes = made.tubes
    return Law(
        parts=tuple((part.name, part.errors) for part in tubes.parts),
        initial_shape=tubes.initial_shape,
        initial_rho=tubes.initial_rho,
        terminal_shape=tubes.terminal_shape,
        terminal_rho=tubes.terminal_rho,
        nominal_shape=tubes.nominal_shape,
        nominal_rho=tubes.nominal_rho,
        metric=tubes.metric,
        size=tubes.size,
        size_nominal=tubes.size_nominal,
        gains=made.law.gains,
        coefficients=made.law.coefficients,
        exponents=made.law.exponents,
        coordinates=made.law.coordinates.kind,
        room=made.law.room,
        reach=made.law.unwhitening,
        feasible=made.feasible,
        solve_seconds=made.solve_seconds,
        certificate=tubes.certificate,
        certificate_nominal=tubes.certificate_nominal,
        polynomial_size=tubes.polynomial_size,
        shares=tubes.shares,
        control=tubes.control,
        boundary=tubes.boundary,
        certify_seconds=tubes.certify_seconds,
        sampling={**asdict(tubes.sampling), "share": tubes.sampling.share},
        notes=tubes.messages,
        messages=tuple(made.messages),
        evidence=made.evidence,
        settings=prepared.source.scenario.synthesis.setting(key),
        margins=verify.margins(
            made.linearisation.A,
            made.linearisation.B,
            verify.linear_part(made.law, prepared.nominal.beats),
            prepared.nominal.dt,
        ),
    )


def ranges(numbers: NDArray[np.intp]) -> str:
    """Rising numbers in words, runs of them as ranges: "0 to 3, 7"."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    return ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)
