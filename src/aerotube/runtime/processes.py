"""Processes beside the controller's, and who of them all hears Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Processes started in this block never hear Ctrl-C: it is the controller's, who ends them in good order.

    They hear nothing from their first instruction on, while they still import; where a process cannot hand on which
    signals it holds back, they are as any other.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # started by the first process otherwise, it would end the block
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def on_interrupt(note: Callable[[], None]) -> Iterator[None]:
    """Have Ctrl-C noted in this block, beside what else it does.

    The exception that it raises is lost where it falls into a callback of other code, as of a compiler's.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    usual = before

    def heard(number: int, frame: FrameType | None) -> None:
        note()
        usual(number, frame)

    signal.signal(signal.SIGINT, heard)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
