"""What the console and the page say of a run."""

import pytest

from aerotube.report import words
from aerotube.report.assurance import containment_html
from aerotube.results import CALM, ESTIMATOR


def worst(disk, at, delay, late):
    return {
        "disk": disk, "gain_db": 6.0 * disk, "phase_deg": 50.0 * disk, "at_beat": at, "delay_ms": delay,
        "delay_at_beat": late,
    }  # fmt: skip


@pytest.fixture
def summary():
    margins = {
        "unstable_beats": 0,
        "elevator": worst(0.5, 1, 40.0, 7),
        "throttle": worst(1.5, 2, None, 0),
        "aileron": worst(0.9, 3, 20.0, 5),
        "all": worst(0.4, 8, 6.0, 4),
    }
    spreads = {"none": {"mean": 1.2, "sd": 0.1}, "compensated": {"mean": 34.0, "sd": 1.0}}
    none = {"none": {"mean": None, "sd": None}, "compensated": {"mean": None, "sd": None}}
    return {
        "laws": {"noise_free": {"margins": margins, "settings": {"size": "worst-case"}}},
        "mean_upper_error": spreads,
        "mean_upper_error_noise": none,
        "mean_upper_error_estimator": none,
        "containment": {
            CALM: {
                "beats": 10, "started_inside": 9, "outside": {"error": 1, "measurement": 0, "wind": 0},
                "violations": {"lateral, size": 0}, "worst": {"lateral, size": 0.5},
            },
            ESTIMATOR: {
                "beats": 10, "started_inside": 0, "outside": {"error": 1, "measurement": 10, "wind": 0},
                "violations": {"lateral, size": 0}, "worst": {"lateral, size": None},
            },
        },
    }  # fmt: skip


@pytest.mark.parametrize(
    ("reduction", "said"),
    [((0.671, 0.039), "−67.1 ± 3.9"), ((-27.047, None), "+2704.7"), ((None, None), "–"), ((0.0, 0.0), "+0.0 ± 0.0")],
)
def test_a_change_has_one_sign(reduction, said):
    assert words.change_words(dict(zip(("mean", "sd"), reduction, strict=True))) == said


def test_each_worst_margin_has_its_own_control_and_beat(summary):
    [line] = words.margin_lines(summary)
    assert "gain ±3.0 dB and phase ±25° (elevator, beat 1), delay 20 ms (aileron, beat 5)" in line
    assert "of all at once, gain ±2.4 dB and phase ±20° (beat 8), delay 6 ms (beat 4)" in line


def test_tubes_that_promise_nothing_say_why(summary):
    calm, estimator = words.containment_lines(summary)
    assert "90.0 % of 10 beats" in calm
    assert "promise nothing" in estimator
    assert "measurement errors; synthesis.noise_free.measurement_error" in estimator
    assert "gust" not in estimator
    page = containment_html(summary)
    assert page.count("promise nothing here") == 1
    assert ">–<" not in page


def test_compensation_that_does_harm_is_told(summary):
    line = words.worse_words(summary)
    assert "34 deg in place of 1.2 (no sensor noise);" in line
    assert "mean-square = 1.0" in line
    summary["mean_upper_error"]["compensated"]["mean"] = 0.3
    assert not words.worse_words(summary)
