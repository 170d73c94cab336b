"""The live view only looks on."""

import sys
import threading
from collections import Counter
from types import SimpleNamespace

from aerotube.runtime.view import _events


def test_the_view_bears_new_reasons_while_it_looks():
    """The controller's thread counts reasons that were not there before."""
    ours, theirs, stop = Counter(range(2000)), Counter(), threading.Event()
    pilot = SimpleNamespace(
        session=SimpleNamespace(refused=ours),
        record=SimpleNamespace(refused=theirs),
        workers=SimpleNamespace(events=[]),
    )

    def count():
        while not stop.is_set():
            for number in range(2000, 2010):
                ours[number] += 1
            for number in range(2000, 2010):
                del ours[number]

    thread, interval = threading.Thread(target=count), sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    thread.start()
    try:
        for _ in range(200):
            assert _events(pilot)
    finally:
        stop.set()
        thread.join()
        sys.setswitchinterval(interval)
