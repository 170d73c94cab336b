"""A process that does nothing but sleep, and measures how much longer than asked: what the machine itself stole."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PERIOD = 2e-3  # s
LEAST = 1e-3  # s; a shorter overrun is a timer's, not a theft


def measure(stop: Any, report: Any, period: float = PERIOD, least: float = LEAST) -> None:
    """Sleep until told to stop, then report (end, seconds) of every sleep that took too long.

    Parameters
    ----------
    stop : connection
        Anything that arrives, or its end, stops the watch.
    report : connection
        Gets one list of pairs: moments on the monotonic clock, seconds.
    period, least : float
        s.
    """
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
    report.send(found)
    report.close()


class Watchdog:
    """The sleeping process, started and stopped."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        stopped, self._stop = context.Pipe(duplex=False)
        self._report, reported = context.Pipe(duplex=False)
        self._process = context.Process(target=measure, args=(stopped, reported), daemon=True)
        self._process.start()
        stopped.close()
        reported.close()

    def stop(self) -> Array:
        """End the watch: ndarray (k, 2), the end of each theft on the monotonic clock and its seconds."""
        found: Sequence[tuple[float, float]] = []
        try:
            self._stop.send(None)
            if self._report.poll(5.0):
                found = self._report.recv()
        except (OSError, EOFError):
            pass
        self._process.join(1.0)
        if self._process.is_alive():
            self._process.terminate()
        return np.asarray(found, dtype=float).reshape(-1, 2)


def stolen(thefts: Array, start: float, end: float) -> float:
    """Seconds that the machine stole between two moments.

    Parameters
    ----------
    thefts : ndarray (k, 2)
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
    return float(np.maximum(np.minimum(thefts[:, 0], end) - np.maximum(begin, start), 0.0).sum())
