"""Workers that die or stall are replaced, and their work is done or given up aloud."""

import multiprocessing
import os
import signal
import threading
import time

import numpy as np
import pytest

from aerotube.runtime.watchdog import Watchdog, measure, stolen
from aerotube.runtime.workers import Job, Killed, Workers


def done(workers, count=1):
    found = []
    until = time.monotonic() + 20.0
    while len(found) < count and time.monotonic() < until:
        found += workers.wait(0.1)
    workers.close()
    return found


def test_work_is_done_once():
    workers = Workers(2)
    for i in range(5):
        workers.submit(Job(i, lambda i=i: i * i, patience=10.0))
    assert sorted((job.key, job.result) for job in done(workers, 5)) == [(i, i * i) for i in range(5)]
    assert workers.events == []


def test_a_dead_workers_job_is_given_to_another():
    attempts = []

    def work():
        attempts.append(threading.current_thread().name)
        if len(attempts) == 1:
            raise Killed
        return "done"

    workers = Workers(1)
    workers.submit(Job("window", work, patience=10.0))
    (job,) = done(workers)
    assert job.result == "done"
    assert job.attempts == 2
    assert len(set(attempts)) == 2
    assert "died" in workers.events[0][1]


def test_a_stalled_workers_job_is_given_to_another():
    release, attempts = threading.Event(), []

    def work():
        attempts.append(0)
        if len(attempts) == 1:
            release.wait(20.0)
            return "too late"
        return "done"

    workers = Workers(1)
    workers.submit(Job("window", work, patience=0.05))
    (job,) = done(workers)
    release.set()
    assert job.result == "done"
    assert "stalled" in workers.events[0][1]


def test_a_job_that_kills_everyone_is_given_up():
    def work():
        raise Killed

    workers = Workers(1, attempts=3)
    workers.submit(Job("window", work, patience=10.0))
    (job,) = done(workers)
    assert job.result is None
    assert "given up" in job.error
    assert job.attempts == 3


def test_an_error_is_told():
    def work():
        raise ValueError("no such beat")

    workers = Workers(1)
    workers.submit(Job("window", work, patience=10.0))
    (job,) = done(workers)
    assert job.error == "ValueError: no such beat"


def test_stolen_time_is_that_within_the_span():
    # on one core from 1.5 to 2 and from 3 to 4, on another from 3.5 to 3.7
    thefts = np.array([[2.0, 0.5, 0], [3.7, 0.2, 1], [4.0, 1.0, 0]])
    assert stolen(thefts, 0.0, 5.0) == pytest.approx(1.5)
    assert stolen(thefts, 1.8, 3.25) == pytest.approx(0.45)
    assert stolen(thefts, 2.1, 2.9) == 0.0
    assert stolen(np.empty((0, 3)), 0.0, 5.0) == 0.0


def test_a_watchdog_that_cannot_keep_to_its_core_says_so():
    """There is no core of that number."""
    stopped, stop = multiprocessing.Pipe(duplex=False)
    report, reported = multiprocessing.Pipe(duplex=False)
    watch = threading.Thread(target=measure, args=(stopped, reported, 100_000), daemon=True)
    watch.start()
    stop.send(None)
    found, trouble = report.recv()
    assert isinstance(found, list)
    assert "core 100000" in trouble


def test_a_watchdog_whose_report_nobody_waits_for_ends_in_silence():
    stopped, stop = multiprocessing.Pipe(duplex=False)
    report, reported = multiprocessing.Pipe(duplex=False)
    stop.close()
    report.close()
    measure(stopped, reported)
    assert reported.closed


def test_watchdogs_report_and_their_loss_is_told():
    watch = Watchdog()
    watch._watches[0][0].kill()
    watch._watches[0][0].join(5.0)
    assert watch.stop().shape[1] == 3
    assert len(watch.troubles) == 1
    assert "has not reported" in watch.troubles[0]


@pytest.mark.skipif(
    not hasattr(signal, "pthread_sigmask"), reason="a process cannot hand on which signals it holds back"
)
def test_an_interrupt_does_not_reach_the_watchdogs_even_while_they_start():
    watch = Watchdog()
    for process, _, _ in watch._watches:
        os.kill(process.pid, signal.SIGINT)
    watch.stop()
    assert watch.troubles == []
    assert [process.exitcode for process, _, _ in watch._watches] == [0] * len(watch._watches)
