import math

import numpy as np
import pytest

from aerotube import scenario
from aerotube.errors import InputError
from aerotube.preparation import prepare

TEXT = scenario.built_in_text()


def changed(old: str, new: str) -> str:
    assert TEXT.count(old) >= 1
    return TEXT.replace(old, new, 1)


def test_the_built_in_scenario_is_table_2():
    chosen = scenario.load().scenario
    start, control, box = chosen.nominal.state, chosen.nominal.control, chosen.disturbance
    degrees = np.degrees([start.alpha, start.q, start.theta, start.beta, start.p, start.r, start.phi])
    np.testing.assert_allclose(degrees, [19.3, 28.2, -50.5, 0.7, -19.7, -9.4, 0.0], atol=1e-12)
    assert (start.V, start.altitude) == (185.0, 3000.0)
    np.testing.assert_allclose(np.degrees([control.elevator, control.aileron, control.rudder]), [-5.3, 3.0, 0.0])
    assert control.throttle == 0.75
    np.testing.assert_allclose(np.degrees(box.half_widths[1:]), [0.5, 0.5, 1.0, 0.5, 1.0, 0.5, 1.0])
    assert (box.half_widths[0], box.mass) == (5.0, 0.05)
    assert (chosen.nominal.horizon, chosen.nominal.beat, chosen.nominal.beats) == (3.0, 0.05, 60)
    assert (chosen.aircraft.xcg, chosen.draws.seeds, chosen.draws.runs) == (0.30, 30, 100)


def test_the_built_in_scenario_says_everything_that_the_defaults_say():
    stated = scenario.parse(TEXT).scenario
    needed = TEXT[TEXT.index("[aircraft]") : TEXT.index("[draws]")]
    assert scenario.parse(needed).scenario.model_dump(exclude={"title", "synthesis"}) == stated.model_dump(
        exclude={"title", "synthesis"}
    )


def test_uncertain_quantities_reach_aircraft_box_and_draws():
    text = changed('inertia = "0 %"', 'inertia = "10 %"')
    text = text.replace('control_effectiveness = "0 %"', 'control_effectiveness = "20 %"').replace(
        "seeds = 30 ", "seeds = 2 "
    )
    prepared = prepare(scenario.parse(text))
    names = ("inverse_mass", "inverse_inertia", "control_effectiveness")
    assert all(plane.parameter_names == names for plane in (prepared.plant, prepared.rigid, prepared.model))
    vertices = prepared.disturbance.parameter_vertices(prepared.model)
    assert vertices.shape == (8, 3)
    drawn = prepared.draws.parameters
    assert drawn.shape == (200, 3)
    assert (drawn >= vertices.min(0)).all()
    assert (drawn <= vertices.max(0)).all()
    plain = prepare(scenario.parse(TEXT.replace("seeds = 30 ", "seeds = 2 ")))
    assert plain.model.parameter_names == ("inverse_mass",)
    np.testing.assert_array_equal(plain.draws.parameters, drawn[:, :1])


def test_a_setting_overrules_the_common_keys():
    text = changed("noise_weight = 1.0", 'noise_weight = 1.0\nshape = "riccati"')
    synthesis = scenario.parse(text).scenario.synthesis
    assert synthesis.setting("noise_free")["shape"] == "cost-to-go"
    assert synthesis.setting("noise")["shape"] == "riccati"
    assert synthesis.setting("noise")["size"] == synthesis.setting("noise_free")["size"]


def test_units_can_be_chosen():
    text = changed('alpha = "19.3 deg"', f'alpha = "{math.radians(19.3)!r} rad"').replace("185 m/s", "666 km/h")
    assert scenario.parse(text).scenario.nominal.state == scenario.load().scenario.nominal.state


def test_overrides_are_kept_beside_the_text():
    source = scenario.load(overrides={"draws.runs": 7, "nominal.horizon": "1 s"})
    assert (source.scenario.draws.runs, source.scenario.nominal.beats) == (7, 20)
    assert source.overrides == {"draws.runs": 7, "nominal.horizon": "1 s"}
    assert source.text == TEXT
    assert source.sha256 == scenario.load().sha256


BAD = {
    "unknown key": (changed("xcg = 0.30", "xgc = 0.30"), ["aircraft.xgc", '"xcg"']),
    "unknown table": (changed("[lqr]", "[lrq]"), ["lrq", '"lqr"']),
    "wrong unit": (changed('alpha = "19.3 deg"', 'alpha = "19.3 kg"'), ["nominal.state.alpha", "kg", "deg"]),
    "unit of another kind": (changed('q = "28.2 deg/s"', 'q = "28.2 deg"'), ["nominal.state.q", "deg/s"]),
    "no unit": (changed('alpha = "19.3 deg"', "alpha = 19.3"), ["nominal.state.alpha", "no unit"]),
    "unit for a plain number": (changed("throttle = 0.75", 'throttle = "0.75"'), ["throttle", "without quotes"]),
    "not a number": (changed("throttle = 0.75", "throttle = nan"), ["throttle", "finite"]),
    "true for a number": (changed("runs = 100 ", "runs = true "), ["draws.runs", "whole number"]),
    "half a run": (changed("runs = 100 ", "runs = 1.5 "), ["draws.runs", "whole number"]),
    "no runs": (changed("runs = 100 ", "runs = 0 "), ["draws.runs", "greater"]),
    "missing key": (changed('phi = "0 deg"', ""), ["nominal.state.phi", "missing"]),
    "unknown choice": (changed('gusts = "none"', 'gusts = "hurricane"'), ["flight.gusts", "severe"]),
    "odd degree": (changed("degree = 4", "degree = 3"), ["synthesis.degree", "even number"]),
    "share without a unit": (changed('mass = "5 %"', "mass = 0.05"), ["disturbance.mass", '"5 %"']),
    "two rates": (changed("degree = 4", "rate_limits = [1.0, 1e5]"), ["rate_limits", "four rates", "60 deg/s"]),
    "rate of another kind": (
        changed("degree = 4", 'rate_limits = ["1 deg/s", "1 deg/s", 1, 1]'),
        ["rate_limits", "rate of thrust", "N/s"],
    ),
    "rate of nothing": (changed("degree = 4", "rate_limits = [1, 0, 1, 1]"), ["the rate of thrust is 0", "positive"]),
    "empty file": ("", ["aircraft is missing", "aerotube init"]),
    "table where a value belongs": (changed('title = "Table 2: pull-out, rolling left"', "title = {}"), ["title"]),
    "value where a table belongs": ("draws = 3\n" + TEXT[: TEXT.index("[draws]")], ["draws", "table"]),
    "zero width": (changed('q = "0.5 deg/s"', 'q = "0 deg/s"'), ["disturbance.q", "greater than 0"]),
    "negative width": (changed('V = "5 m/s"', 'V = "-5 m/s"'), ["disturbance.V", "greater than 0"]),
    "broken horizon": (changed('horizon = "3 s"', 'horizon = "3.01 s"'), ["3.01 s", "whole number of beats"]),
    "horizon below a beat": (changed('horizon = "3 s"', 'horizon = "1 ms"'), ["whole number of beats"]),
    "no horizon": (changed('horizon = "3 s"', 'horizon = "0 s"'), ["nominal.horizon", "greater than 0"]),
    "source without its table": (changed('source = "constant-controls"', 'source = "trim"'), ["trim"]),
    "no TOML": (changed("xcg = 0.30", "xcg = "), ["not valid TOML", "line"]),
    "empty sweep": (changed("noise_weights = [0.0, 2.0, 4.0, 8.0]", "noise_weights = []"), ["lqr.noise_weights"]),
}


@pytest.mark.parametrize(("text", "words"), BAD.values(), ids=BAD.keys())
def test_a_mistake_is_named_in_one_sentence(text, words):
    with pytest.raises(InputError) as caught:
        scenario.parse(text, name="mine.toml")
    sentence = str(caught.value)
    assert "mine.toml" in sentence
    assert "\n" not in sentence
    assert "pydantic" not in sentence
    for word in words:
        assert word in sentence


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.toml.*no such file"):
        scenario.load(tmp_path / "nothing.toml")


def test_a_file_that_is_no_text_is_named(tmp_path):
    (tmp_path / "binary.toml").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match=r"binary\.toml.*UTF-8"):
        scenario.load(tmp_path / "binary.toml")


def test_a_folder_is_no_scenario(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        scenario.load(tmp_path)


def test_rates_are_quantities_or_si():
    text = changed("degree = 4", 'rate_limits = ["180 deg/s", "60 kN/s", 1.5, "2 rad/s"]')
    assert scenario.parse(text).scenario.synthesis.rate_limits == pytest.approx([math.pi, 6e4, 1.5, 2.0])


@pytest.mark.parametrize(("key", "most"), [("degree = 20", "at most 8"), ("reuse = 70", "at most 59")])
def test_what_would_not_end_or_makes_no_sense_is_refused(key, most):
    name = key.split()[0]
    line = next(line for line in TEXT.splitlines() if line.startswith(f"{name} = "))
    with pytest.raises(InputError, match=f"{name} is .*{most}"):
        prepare(scenario.parse(changed(line, key)))


def test_an_option_is_named_as_it_was_typed():
    with pytest.raises(InputError, match=r"^--noise -1: flight\.noise must be greater than or equal to 0$"):
        scenario.load(overrides={"flight.noise": "-100 %"}, typed={"flight.noise": "--noise -1"})
