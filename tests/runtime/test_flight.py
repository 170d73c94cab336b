"""Whole flights: the simulation's numbers, the log's, faults, and another's aircraft."""

import copy
import json
import signal
import socket
import struct
import threading
import zlib
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from aerotube import flight
from aerotube.compensation import KINDS
from aerotube.dynamics import ErrorCoordinates
from aerotube.preparation import prepare
from aerotube.runtime import aircraft_process, log
from aerotube.runtime import flight as flights
from aerotube.runtime.actuators import Actuators
from aerotube.runtime.channels import QueueChannel
from aerotube.runtime.commander import Source
from aerotube.runtime.faults import Faults
from aerotube.runtime.flight import fly
from aerotube.runtime.limits import what_limits
from aerotube.runtime.messages import Kind, Rung
from aerotube.runtime.options import Options, make_estimator, make_world
from aerotube.runtime.outcome import deadlines, errors_flown, summarise
from aerotube.runtime.page import save
from aerotube.runtime.plant import Plant
from aerotube.runtime.promises import promises
from aerotube.runtime.replay import replay
from aerotube.runtime.session import Session
from aerotube.runtime.words import broken_off, told
from aerotube.scenario import load

CALM = Options(speed=np.inf, link="thread", window=6, workers=1)


@pytest.fixture(scope="module")
def undisturbed(prepared):
    return fly(prepared, replace(CALM, duration=1.2, deviation="box", gusts="light"))


def simulated(prepared, flown):
    """The same draws through `flight.simulate`, with the laws of the first manoeuvre."""
    law = flown.record.laws[: prepared.nominal.beats].batch(flown.record.form, ErrorCoordinates())
    return flight.simulate(
        prepared.plant,
        prepared.nominal,
        law,
        flown.world.draws,
        noise=flown.world.noise,
        estimator=make_estimator(prepared, flown.options),
        gusts=flown.world.gusts,
        substeps=flown.options.substeps,
    )


def test_an_undisturbed_flight_is_the_simulation(prepared, undisturbed):
    found = simulated(prepared, undisturbed)
    beats = prepared.nominal.beats
    assert errors_flown(undisturbed) == pytest.approx(found.error, abs=1e-8)
    assert undisturbed.record.command.reshape(2, beats, 4) == pytest.approx(found.control, abs=1e-9)
    alone = flight.simulate(
        prepared.plant, prepared.nominal, None, undisturbed.world.draws, gusts=undisturbed.world.gusts, substeps=5
    )
    assert undisturbed.alone == pytest.approx(alone.error, abs=1e-9)
    assert not deadlines(undisturbed).missed.any()
    assert set(undisturbed.record.fallbacks().values()) == {0}


def test_with_the_estimator_too(prepared):
    flown = fly(prepared, replace(CALM, estimator=True))
    assert errors_flown(flown) == pytest.approx(simulated(prepared, flown).error, abs=1e-8)


def test_the_summary_has_its_keys(undisturbed):
    summary = summarise(undisturbed)
    assert list(summary) == [
        "beats",
        "seconds",
        "seconds_asked",
        "ended",
        "broken_off",
        "missed_deadlines",
        "missed_explained",
        "missed_unexplained",
        "faults",
        "fallbacks",
        "certificates",
        "promises",
        "mae",
        "rmse",
        "latency_us",
        "realtime_factor",
        "window_ms",
    ]
    assert summary["beats"] == 24
    for key in ("mae", "rmse"):
        assert 0 < summary[key]["compensated"] < summary[key]["none"]
    assert set(summary["latency_us"]) == {"median", "p99"}
    spent = summary["window_ms"]
    assert set(spent) == {"whole", "check", "design", "certify"}
    assert spent["check"] == 0.0, "nothing was kept, so nothing was checked"
    assert json.loads(json.dumps(summary)) == summary


def test_a_log_flies_again_to_the_same_numbers(prepared, tmp_path):
    options = replace(
        CALM, estimator=True, replan=0.05, delay=1, actuators=True, gusts="moderate", deviation="box", duration=1.2
    )
    flown = fly(prepared, options)
    summary = save(flown, tmp_path)
    dataset = log.read(tmp_path / "flight.nc")
    found = replay(dataset)
    assert found["state"] == 0.0
    assert found["command"] == 0.0
    assert found["mae"] == summary["mae"]["compensated"]
    assert summary == json.loads((tmp_path / "fly.json").read_text())
    assert not np.allclose(flown.record.nominal_control, prepared.nominal.controls[0])
    page = (tmp_path / "report.html").read_text()
    assert "data:image/png" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    other = dataset.copy(deep=True)
    other["measured"].values[3, 0] += 1e-3
    assert replay(other)["command"] > 0.0


@pytest.mark.parametrize(
    "chosen",
    [{"saturation": 4}, {"law_degree": 2}, {"law_degree": 3, "saturation": 2}],
    ids=["saturating", "quadratic", "cubic"],
)
def test_laws_of_any_form_fly_as_they_are_simulated_and_replayed(chosen, tmp_path):
    overrides = {f"synthesis.{key}": value for key, value in chosen.items()}
    prepared = prepare(load(None, {"nominal.horizon": "0.3 s", **overrides}))
    flown = fly(prepared, replace(CALM, deviation="box", window=3, seed=5))
    record = flown.record
    assert (record.rung == Rung.PLANNED).all()
    assert (record.kind == KINDS.index("sampled")).all()
    assert errors_flown(flown) == pytest.approx(simulated(prepared, flown).error, abs=1e-8)
    assert (record.command >= flown.world.aircraft.control_lower).all()
    assert (record.command <= flown.world.aircraft.control_upper).all()
    summary = save(flown, tmp_path)
    assert summary["certificates"] == {"sampled": 6, "none": 0}
    found = replay(log.read(tmp_path / "flight.nc"))
    assert found["state"] == 0.0
    assert found["command"] == 0.0


@pytest.mark.parametrize(
    "chosen", [{}, {"saturation": 4}, {"law_degree": 2}], ids=["linear", "saturating", "quadratic"]
)
def test_faults_are_survived_logged_and_never_leave_the_limits(chosen):
    overrides = {f"synthesis.{key}": value for key, value in chosen.items()}
    prepared = prepare(load(None, {"nominal.horizon": "0.6 s", **overrides}))
    options = replace(CALM, speed=12.0, duration=36.0, faults=300, deviation="box", noise=0.0, seed=3)
    flown = fly(prepared, options)
    record, faults = flown.record, flown.faults
    assert record.flown == 720
    # all but those whose beat or window the flight did not get to: the last beat of a late flight has no measurement
    left = len(faults.of_beats) + len(faults.of_windows)
    assert sum(faults.injected.values()) == 300 - left
    assert left < 10
    assert summarise(flown)["faults"] == faults.injected
    commands = record.command[np.isfinite(record.command[:, 0])]
    assert (commands >= flown.world.aircraft.control_lower).all()
    assert (commands <= flown.world.aircraft.control_upper).all()
    assert flown.truth.illegal == 0
    assert np.isfinite(flown.truth.states).all()
    # no silent fallback: what took a measurement away shows in the beat's source, and nothing flies without a rung
    for beat, kind in faults.by_beat.items():
        if beat < record.flown and kind in ("drop", "corrupt", "nan") and beat not in faults.given_back:
            assert record.source[beat] != Source.MEASURED, (beat, kind)
        if beat < record.flown and kind in ("drop", "corrupt", "delay") and record.source[beat] == Source.MEASURED:
            # held back or replayed while the beat was late itself: then it is that beat's own measurement
            true = flown.truth.states[divmod(beat, flown.world.beats)]
            assert record.measured[beat, : len(true)] == pytest.approx(true, rel=1e-9, abs=1e-12)
    # no certificate is claimed for a beat without a certified law that was given its own measurement
    assert (record.kind[(record.source != Source.MEASURED) | (record.rung.max(1) > Rung.LAST)] < 0).any(axis=1).all()
    reached = record.source >= 0
    assert (record.rung[reached] >= 0).all()
    alone = (record.rung == Rung.NOMINAL).all(axis=1) & reached
    assert record.command[alone] == pytest.approx(record.nominal_control[alone])
    assert record.refused["alien sender"] >= 0.5 * faults.injected["alien"]


def test_beats_that_start_inside_end_in_their_tubes(prepared):
    flown = fly(prepared, replace(CALM, duration=1.8, deviation="box", seed=2))
    found = promises(flown)
    assert found["certified"] == 36
    assert found["promised"] > 0.8 * 36
    assert found["left"] == 0
    assert found["why"] is None
    record = copy.copy(flown.record)
    record.size = 1e-6 * flown.record.size
    smaller = promises(replace(flown, record=record))
    assert smaller == found | {"left": found["promised"]}
    far = replace(flown.truth, states=flown.truth.states + np.r_[30.0, np.zeros(12)])
    assert promises(replace(flown, truth=far))["promised"] == 0


def test_behind_an_estimator_tubes_promise_what_the_setting_that_is_named_allows(prepared):
    none = promises(fly(prepared, replace(CALM, estimator=True)))
    assert none["promised"] == 0
    assert "measurement_error in [synthesis.noise_free]" in none["why"]
    allowing = {"nominal.horizon": "0.6 s", "synthesis.noise_free.measurement_error": "100 %"}
    some = promises(fly(prepare(load(None, allowing)), replace(CALM, estimator=True)))
    assert some["promised"] > 0
    assert some["left"] == 0


def test_an_interrupted_flight_says_which_beats_are_not_looked_at(prepared):
    def interrupt(pilot):
        if pilot.record.flown > 15:
            raise KeyboardInterrupt

    flown = fly(prepared, replace(CALM, speed=4.0, duration=60.0), view=interrupt)
    assert flown.interrupted
    summary = summarise(flown)
    assert summary["ended"] == "interrupted"
    whole = flown.truth.flown_manoeuvres * prepared.nominal.beats
    assert summary["broken_off"] == summary["beats"] - whole >= 0
    assert sum(summary["certificates"].values()) == summary["beats"]
    assert summary["promises"]["certified"] <= whole
    words = told(summary)
    assert words[0].startswith("interrupted")
    assert not summary["broken_off"] or broken_off(summary) in words


def test_an_interruption_that_gets_lost_in_the_preparations_is_heeded(prepared):
    """As in a callback of the compiler's, which drops what is raised in it."""

    def tell(words):
        if words.startswith("compiling"):
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

    flown = fly(prepared, CALM, tell)
    assert flown.interrupted
    assert flown.record.flown == 0


def test_a_view_that_fails_ends_alone(prepared):
    def fail(pilot):
        raise RuntimeError("no such screen")

    said = []
    flown = fly(prepared, replace(CALM, speed=4.0), said.append, fail)
    assert summarise(flown)["ended"] == "whole"
    assert sum("no such screen" in words for words in said) == 1


def test_an_aircraft_whose_last_command_is_lost_flies_to_the_end(prepared):
    """The controller says goodbye when its last command is out."""
    home, away = QueueChannel.pair()
    world = make_world(prepared, CALM)
    truths = []
    thread = threading.Thread(target=lambda: truths.append(aircraft_process.fly(world, away)), daemon=True)
    thread.start()
    session = Session(home, world.token)
    while (message := session.receive(20.0)) is not None and message.kind != Kind.GOODBYE:
        if message.kind == Kind.HELLO:
            session.send(Kind.HELLO, values=message.values)
        elif message.kind == Kind.MEASUREMENT and message.beat == world.beats - 1:
            session.send(Kind.GOODBYE)
        elif message.kind == Kind.MEASUREMENT:
            session.send(Kind.COMMAND, message.beat, tuple(world.controls[message.beat].tolist()))
    thread.join(20.0)
    assert truths[0].flown_manoeuvres == 1
    assert truths[0].taken[0].tolist() == [0] * (world.beats - 1) + [-1]


def test_tubes_promise_nothing_of_what_they_do_not_know(prepared, undisturbed):
    found = promises(undisturbed)
    assert found["promised"] == 0, "gusts, and the tubes are for still air"
    assert "gusts of 0 m/s" in found["why"]
    assert promises(replace(undisturbed, options=replace(undisturbed.options, delay=1))) is None


@pytest.mark.parametrize("kind", ["kill", "stall"])
def test_deadlines_missed_for_an_injected_fault_are_counted_apart(prepared, monkeypatch, kind):
    monkeypatch.setattr(flights, "_faults", lambda *_: Faults({}, {6: kind}, stall=2.0))
    flown = fly(prepared, replace(CALM, speed=4.0, faults=1))
    assert flown.faults.injected == {kind: 1}
    late = flown.record.law_late
    assert deadlines(flown).by_fault.tolist() == [g >= 6 and bool(late[g]) for g in range(12)]
    summary = summarise(flown)
    assert summary["faults"] == {kind: 1}
    explained = summary["missed_explained"]
    assert explained["fault"] == late[6:].sum()
    assert kind == "kill" or explained["fault"], "the others are patient for longer than the window has"
    assert summary["missed_deadlines"] == sum(explained.values()) + summary["missed_unexplained"]


@pytest.mark.parametrize("kind", ["drop", "delay", "corrupt", "nan", "garbage"])
def test_a_flight_goes_on_though_its_first_measurement_is_hit(prepared, monkeypatch, kind):
    monkeypatch.setattr(flights, "_faults", lambda *_: Faults({0: kind}))
    flown = fly(prepared, replace(CALM, speed=4.0, faults=1))
    assert flown.faults.by_beat == {0: kind}
    assert flown.record.flown == prepared.nominal.beats
    assert flown.truth.flown_manoeuvres == 1
    assert (flown.record.source == Source.MEASURED).any()


def test_what_limits_the_tracking_is_the_noise(undisturbed):
    """Less noise is never worse, without an estimator; and what was flown is among the conditions."""
    found = what_limits(undisturbed)
    assert [limit.condition for limit in found[:2]] == [
        "no sensor noise",
        "sensor noise of 100 % of the disturbance box, no estimator",
    ]
    heard = [limit.mae for limit in found if "no estimator" in limit.condition]
    assert len(heard) == 4
    assert found[0].mae < heard[-1]
    assert heard == sorted(heard, reverse=True)
    assert found[1].mae == pytest.approx(summarise(undisturbed)["mae"]["compensated"], rel=1e-9)


def test_what_is_kept_is_told(prepared, tmp_path):
    """The same nominal again: every law of the second manoeuvre holds, and none is designed."""
    flown = fly(prepared, replace(CALM, duration=1.2, tolerance=0.0))
    save(flown, tmp_path)
    dataset = log.read(tmp_path / "flight.nc")
    assert dataset["window_kept"].values.tolist() == [0, 0, 6, 6]
    assert dataset["window_designed"].values.tolist() == [12, 12, 0, 0]
    assert (flown.record.kind == KINDS.index("sampled")).all()
    assert "Kept: 12 of 24 beats (50 %)" in (tmp_path / "report.html").read_text()
    assert replay(dataset)["command"] == 0.0


def speak(kind, sequence, beat, values, token=42):
    """A datagram written by hand, as the interface's table says."""
    body = struct.pack(f"<4sBBHQIId{len(values)}d", b"AERO", 1, kind, 0, token, sequence, beat, 0.0, *values)
    return body + struct.pack("<I", zlib.crc32(body))


def other_aircraft(port, states, heard):
    """Somebody else's aircraft: it knows the table of the interface, and nothing of this package."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.settimeout(0.1)
    home, sequence = ("127.0.0.1", port), 0

    def ask(kind, beat, values):
        nonlocal sequence
        for _ in range(600):
            sequence += 1
            sock.sendto(speak(kind, sequence, beat, values), home)
            try:
                data = sock.recv(500)
            except (TimeoutError, ConnectionError):
                continue
            if data[5] == (1 if kind == 1 else 3):
                return data
        raise AssertionError("the controller does not answer")

    ask(1, 0, (0.05, float(len(states)), 13.0, 1e300))
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for beat, state in enumerate(states):
        stranger.sendto(speak(2, 1, beat, (1.0,) * 16, token=43), home)
        data = ask(2, beat, (*state, 0.0, 0.0, 0.0))
        heard.append(struct.unpack_from("<4d", data, 32))
    sock.close()
    stranger.close()


def test_anothers_aircraft_is_flown_over_udp(prepared):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    states = prepared.nominal.states[: prepared.nominal.beats].tolist()
    heard: list[tuple[float, ...]] = []
    other = threading.Thread(target=other_aircraft, args=(port, states, heard), daemon=True)
    said: list[str] = []

    def tell(words):
        said.append(words)
        if words == f"waiting for an aircraft at UDP port {port} (127.0.0.1); Ctrl-C ends":
            other.start()

    flown = fly(prepared, replace(CALM, port=port), tell)
    other.join(20.0)
    assert len(heard) == prepared.nominal.beats
    assert [words for words in said if "waiting" in words or words == "take-off"][1:] == ["take-off"]
    # it flew exactly along the nominal: nothing to compensate
    assert np.array(heard) == pytest.approx(prepared.nominal.controls, abs=1e-9)
    assert flown.truth is None
    assert summarise(flown)["mae"] == {"none": None, "compensated": None}


def test_commands_come_late_by_whole_beats(prepared, undisturbed):
    plant = Plant(replace(undisturbed.world, delay=2, noise=0.0, gusts=None))
    sent = [prepared.nominal.controls[0] + [0.01 * k, 0.0, 0.0, 0.0] for k in range(5)]
    for k in range(5):
        plant.next_beat()
        plant.command(sent[k])
        plant.advance(k, 0)
    flown = plant.flown[0, :5, 0]
    assert flown[:2] == pytest.approx(prepared.nominal.controls[:2])
    assert flown[2:] == pytest.approx(np.array(sent[:3]))


def test_actuators_lag_and_keep_their_rates():
    made = Actuators()
    start, far = np.array([0.0, 0.5, 0.0, 0.0]), np.array([0.3, 1.0, 0.001, 0.0])
    moved = made.move(start, far, 0.01)
    assert moved[0] == pytest.approx(np.radians(60.0) * 0.01)
    assert moved[1] == 1.0
    assert moved[2] == pytest.approx(0.001 * (1.0 - np.exp(-0.202)))
    for _ in range(1000):
        moved = made.move(moved, far, 0.01)
    assert moved == pytest.approx(far, abs=1e-9)


def test_illegal_commands_are_not_flown(undisturbed):
    plant = Plant(undisturbed.world)
    for wrong in ((np.nan, 0.5, 0.0, 0.0), (0.0, 1.5, 0.0, 0.0), (9.0, 0.5, 0.0, 0.0)):
        assert not plant.command(wrong)
    assert plant.illegal == 3
