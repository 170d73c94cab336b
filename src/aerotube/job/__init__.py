"""The main job: scenario, nominal trajectory, laws and tubes, flights, results, report.

Each step is a function of what the step before made. What has been computed is kept in a `Record` as it comes, so
that a failure or an interruption later on loses nothing of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from aerotube import results, scenario
from aerotube.job.parts import Progress, compute, new_record
from aerotube.preparation import prepare
from aerotube.results import Record

__all__ = ["Progress", "compute", "new_record", "run", "save", "save_certificates"]


def save_certificates(record: Record, folder: Path) -> None:
    """Write a certificate for the size of every tube, to be checked offline by ``aerotube check``.

    Parameters
    ----------
    record : Record
    folder : Path
        Gets ``certificates/SETTING/beat_BEAT_PART.json``, one file for each tube that has one.
    """
    for key, law in record.laws.items():
        target = results.ensure_folder(folder / "certificates" / key)
        for (name, _), evidence in zip(law.parts, law.evidence, strict=True):
            for beat in np.flatnonzero(evidence.holds):
                evidence.save(target / f"beat_{beat:03d}_{name}.json", (int(beat),))


def save(record: Record, folder: Path) -> dict[str, Any]:
    """Write dataset, summary, figures and report of a record.

    Parameters
    ----------
    record : Record
        Complete or not.
    folder : Path
        Exists.

    Returns
    -------
    dict
        The summary.
    """
    from aerotube import report

    dataset = results.build(record)
    results.write(dataset, folder / "results.nc")
    summary = results.summarise(dataset)
    results.write_json(folder / "summary.json", summary)
    report.write(dataset, folder)
    return summary


def run(
    source: scenario.Source,
    folder: str | Path,
    workers: int = 1,
    progress: Progress | None = None,
    certificates: bool = False,
) -> dict[str, Any]:
    """Do the main job: fly a scenario and write its results.

    Parameters
    ----------
    source : scenario.Source
    folder : str or Path
        Made if it is not there.
    workers : int
        Threads that solve; the numbers do not depend on it.
    progress : callable, optional
    certificates : bool
        Write the tubes' certificates as well.

    Returns
    -------
    dict
        The summary that was written; ``problems`` has the computed failures, ``interrupted`` says whether the
        work was cut short.

    Raises
    ------
    InputError
        If the scenario cannot be flown or the folder not be written; nothing has been written then.
    KeyboardInterrupt
        If it was interrupted before anything was finished, and nothing has been written; or, with a sentence that
        says so, while it was being written.
    """
    prepared = prepare(source)
    record = new_record(prepared)
    with results.out_folder(folder) as target:
        try:
            compute(prepared, record, workers, progress)
        except KeyboardInterrupt:
            if not record.laws and not record.cases:
                raise
            record.interrupted = True
        except BaseException:
            # An error nobody foresaw: keep what there is before it is shown.
            record.problems.append("an unforeseen error ended the run early")
            save(record, target)
            raise
        try:
            summary = save(record, target)
            if certificates:
                save_certificates(record, target)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted while writing; in {folder} some files are new and whole, the others missing or of an "
                "earlier run"
            ) from None
    if progress is not None:
        progress("done", 1.0)
    return summary
