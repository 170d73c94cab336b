"""The work of a run, part by part, into its record."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial

from aerotube import compensation, results
from aerotube.errors import ComputationError
from aerotube.job.cases import Cases
from aerotube.job.laws import design
from aerotube.preparation import SETTINGS, Prepared, coefficient_curves, error_states
from aerotube.results import Record

#: Told what is being done, and which part of the whole is done (0 to 1).
Progress = Callable[[str, float], None]

#: Told which share of one part is done.
Share = Callable[[float], None]


def new_record(prepared: Prepared) -> Record:
    """Start the record of a run with what is known before anything is computed."""
    chosen, plant = prepared.source.scenario, prepared.model
    alpha, coefficients = coefficient_curves(prepared.plant)
    return Record(
        times=prepared.nominal.times,
        nominal_error_states=error_states(prepared.nominal.states),
        nominal_controls=prepared.nominal.controls,
        nominal_states=prepared.nominal.states,
        full_state_names=plant.state_names,
        full_state_units=plant.state_units,
        half_widths=prepared.disturbance.half_widths,
        control_lower=plant.control_lower,
        control_upper=plant.control_upper,
        seeds=chosen.draws.seed_values,
        runs=chosen.draws.runs,
        conditions=prepared.conditions,
        provenance=results.provenance(prepared.source),
        coefficient_alpha=alpha,
        coefficients=coefficients,
    )


def compute(prepared: Prepared, record: Record, workers: int = 1, progress: Progress | None = None) -> None:
    """Compute laws and flights into a record, part by part.

    Parameters
    ----------
    prepared : Prepared
    record : Record
        Filled as the parts are finished; computed failures are put down in ``problems``.
    workers : int
        Threads that solve; the numbers do not depend on it.
    progress : callable, optional
    """
    # One more for the writing, which follows.
    total = len(SETTINGS) + len(results.CONTROLLERS) * len(prepared.conditions) + 1
    for done, (words, part) in enumerate(_steps(prepared, record, workers)):

        def tell(share: float, done: int = done, words: str = words) -> None:
            if progress is not None:
                progress(words, (done + share) / total)

        tell(0.0)
        start = time.perf_counter()
        try:
            part(tell)
            record.seconds[words] = round(time.perf_counter() - start, 3)
        except ComputationError as error:
            record.problems.append(f"{words}: {error}")
    if progress is not None:
        progress("results and report", (total - 1) / total)


def _steps(prepared: Prepared, record: Record, workers: int) -> Iterator[tuple[str, Callable[[Share], None]]]:
    """The parts of the work, in order; each puts what it made into the record."""
    laws: dict[str, compensation.Compensation] = {}
    for key in SETTINGS:
        yield f"laws, {key.replace('_', '-')} setting", partial(design, prepared, record, key, laws, workers)
    flights = Cases(prepared, laws)
    for condition in prepared.conditions:
        for controller in results.CONTROLLERS:
            if controller == "compensated" and results.SETTING[condition] not in laws:
                continue  # its failure is on record
            words = f"flights, {results.CONDITION_WORDS[condition]}, {results.CONTROLLER_WORDS[controller]}"

            def part(_: Share, controller: str = controller, condition: str = condition) -> None:
                case = flights.fly(controller, condition)
                if not any(case is known for known in record.cases.values()):
                    record.problems.extend(f"{condition}, {controller}: {message}" for message in case.messages)
                record.cases[controller, condition] = case

            yield words, part
