"""The command that tells the tube of a moment."""

import json

import numpy as np
import pytest

from aerotube.compensation import gauge_beat
from aerotube.preparation import prepare
from aerotube.scenario import load
from tests.cli.test_cli import aerotube, one_sentence

QUICK = ("--certificate", "polynomial only")


def test_a_moment_of_the_manoeuvre_is_the_synthesis_there(capsys, tmp_path):
    picture = tmp_path / "tube.svg"
    code, out, _ = aerotube(capsys, "tube", "--time", 0.1, "--json", "--figure", picture)
    assert code == 0
    told, prepared = json.loads(out), prepare(load())
    reading = gauge_beat(prepared.model, prepared.nominal, 2, prepared.disturbance, prepared.settings["noise_free"])
    assert told["half_widths"]["V"]["compensated"] == pytest.approx(reading.half_widths[0], rel=1e-6)
    assert told["half_widths"]["p"]["nominal"] == pytest.approx(np.degrees(reading.half_widths_nominal[5]), rel=1e-6)
    assert told["half_widths"]["q"]["start"] == pytest.approx(1.0)
    assert told["parts"]["lateral"]["ratio"] == pytest.approx(reading.ratio[1], rel=1e-6)
    assert told["parts"]["lateral"]["certificate"] == str(reading.certificate[1])
    assert told["gains"]["elevator"]["q"] == pytest.approx(reading.gains[0, 2])
    assert told["gains"]["thrust"]["alpha"] == pytest.approx(np.radians(reading.gains[1, 1]))
    assert "<svg" in picture.read_text(encoding="utf-8")


def test_a_condition_and_a_disturbance_of_ones_own(capsys):
    condition = ("tube", *QUICK, "--state", "V=210 m/s, alpha=8 deg", "--control", "throttle=0.5", "--json")
    code, out, _ = aerotube(capsys, *condition)
    assert code == 0
    code, wider, _ = aerotube(capsys, *condition, "--disturbance", "V=10 m/s, mass=0 %")
    assert code == 0
    one, other = (json.loads(text)["half_widths"] for text in (out, wider))
    assert other["V"]["start"] == pytest.approx(2 * one["V"]["start"])
    assert other["V"]["nominal"] > 1.5 * one["V"]["nominal"]
    assert other["p"]["start"] == pytest.approx(one["p"]["start"])


def test_tables_show_what_there_is(capsys):
    code, out, _ = aerotube(capsys, "tube", *QUICK, "--gains", "--setting", "noise")
    assert code == 0
    for word in ("half-widths", "deg/s", "lateral", "polynomial only", "thrust (N)", "with the law", "√4 = 2 times"):
        assert word in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--time", 9), "3 s long"),
        (("--time", "nan"), "outside the manoeuvre"),
        (("--state", "V=20 deg"), "no unit of speed"),
        (("--state", "V"), "no pair"),
        (("--state", "V=1 m/s, V=2 m/s"), "twice"),
        (("--state", "mach=0.5"), "there is no mach; known here: V, alpha"),
        (("--state", "V=0 m/s"), "positive airspeed"),
        (("--state", "altitude=40 km"), "altitude is 40000 m"),
        (("--state", "altitude=100 km"), "outside the range 0 to 15240 m"),
        (("--figure", "tube.xyz"), "its ending is not one of those there are"),
        (("--figure", "nowhere/tube.png"), "--figure nowhere/tube.png cannot be written"),
        (("--control", "throttle=high"), '"high" is no number'),
        (("--control", "elevator=40 deg"), "limits of -20 deg to 20 deg"),
        (("--disturbance", "mach=3 %"), "disturbance.mach is an unknown key"),
        (("--disturbance", "mass=5"), "has no unit"),
        (("--setting", "loud"), "choose noise_free or noise"),
        (("--certificate", "gold"), "unknown certificate 'gold'"),
    ],
)
def test_mistakes_are_one_sentence(capsys, arguments, words):
    code, out, errors = aerotube(capsys, "tube", *arguments)
    assert code == 2
    assert not out
    assert one_sentence(errors)
    assert words in errors
