"""Processes that do nothing but sleep, and measure how much longer than asked: what the machine itself stole.

One keeps to each core, since a machine that is short of time may be so on one core and not on another.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.runtime.processes import deaf_to_interrupts

Array = NDArray[np.float64]

PERIOD = 2e-3  # s
_MOST = 8  # cores that are watched
LEAST = 1e-3  # s; a shorter overrun is a timer's, not a theft


def measure(stop: Any, report: Any, core: int | None = None, period: float = PERIOD, least: float = LEAST) -> None:
    """Sleep until told to stop, then report (end, seconds) of every sleep that took too long.

    Parameters
    ----------
    stop : connection
        Anything that arrives, or its end, stops the watch.
    report : connection
        Gets one list of pairs, moments on the monotonic clock and seconds, and a sentence: why the watch could not keep
        to its core, empty where it could.
    core : int, optional
        To keep to.
    period, least : float
        s.
    """
    trouble = ""
    if core is not None:
        try:
            os.sched_setaffinity(0, {core})
        except OSError as error:  # it still measures, on whichever core it is given
            trouble = f"the watchdog of core {core} does not keep to it ({error}): thefts on it may go unseen"
    found: list[tuple[float, float]] = []
    try:
        before = time.monotonic()
        while not stop.poll():
            time.sleep(period)
            now = time.monotonic()
            over = now - before - period
            if over > least:
                found.append((now, over))
            before = now
    except (KeyboardInterrupt, OSError, EOFError):
        pass
    with suppress(OSError):  # nobody waits for it any more
        report.send((found, trouble))
    report.close()


class Watchdog:
    """The sleeping processes, started and stopped.

    Attributes
    ----------
    troubles : list of str
        After `stop`: one sentence for each watch that did not do what it should.
    """

    def __init__(self) -> None:
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [None]
        context = multiprocessing.get_context("spawn")
        self.troubles: list[str] = []
        self._watches: list[tuple[Any, Any, Any]] = []
        for core in cores[:_MOST]:
            stopped, stop = context.Pipe(duplex=False)
            report, reported = context.Pipe(duplex=False)
            process = context.Process(target=measure, args=(stopped, reported, core), daemon=True)
            with deaf_to_interrupts():
                process.start()
            stopped.close()
            reported.close()
            self._watches.append((process, stop, report))

    def stop(self) -> Array:
        """End the watch: ndarray (k, 3), the end of each theft on the monotonic clock, its seconds, and which watch."""
        rows: list[tuple[float, float, float]] = []
        for number, (process, stop, report) in enumerate(self._watches):
            try:
                stop.send(None)
                if not report.poll(5.0):
                    raise EOFError
                found, trouble = report.recv()
            except (OSError, EOFError):
                found, trouble = (
                    [],
                    f"watchdog {number} has not reported: thefts on its core are unknown",
                )
            rows += [(end, seconds, float(number)) for end, seconds in found]
            self.troubles += [trouble] if trouble else []
            process.join(1.0)
            if process.is_alive():
                process.terminate()
        return np.asarray(sorted(rows), dtype=float).reshape(-1, 3)


def stolen(thefts: Array, start: float, end: float) -> float:
    """Seconds that the machine stole between two moments, on the core where it stole most.

    Parameters
    ----------
    thefts : ndarray (k, 3)
        As :meth:`Watchdog.stop` gives them.
    start, end : float
        On the monotonic clock.

    Returns
    -------
    float
    """
    if len(thefts) == 0:
        return 0.0
    begin = thefts[:, 0] - thefts[:, 1]
    within = np.maximum(np.minimum(thefts[:, 0], end) - np.maximum(begin, start), 0.0)
    return float(np.bincount(thefts[:, 2].astype(int), within).max())
