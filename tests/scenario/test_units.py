import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aerotube.units import DISPLAY, UNITS, parse_quantity

KINDS = [(kind, unit) for kind, units in UNITS.items() for unit in units]
NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)


@given(NUMBERS, st.sampled_from(KINDS))
def test_a_quantity_is_its_number_times_the_size_of_its_unit(number, kind_and_unit):
    kind, unit = kind_and_unit
    assert parse_quantity(f"{number!r} {unit}", kind) == pytest.approx(number * parse_quantity(f"1 {unit}", kind))


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        ("180 deg", "angle", math.pi),
        ("360 deg/s", "angular rate", 2 * math.pi),
        ("36 km/h", "speed", 10.0),
        ("1 kt", "speed", 1852 / 3600),
        ("1 ft/s", "speed", 0.3048),
        ("3 km", "length", 3000.0),
        ("10000 ft", "length", 3048.0),
        ("50 ms", "time", 0.05),
        ("5 %", "ratio", 0.05),
        ("160 slug ft^2/s", "angular momentum", 216.931),
        ("-1.5e1deg", "angle", -math.pi / 12),
    ],
)
def test_known_quantities(text, kind, expected):
    assert parse_quantity(text, kind) == pytest.approx(expected, rel=1e-5)


@given(NUMBERS, st.sampled_from(sorted(DISPLAY)))
def test_what_is_shown_reads_back_as_what_is_inside(value, name):
    display = DISPLAY[name]
    kinds = [kind for kind, units in UNITS.items() if display.unit in units]
    if not kinds:
        assert display.factor == 1.0  # a plain number is shown as it is
    else:
        assert parse_quantity(f"{display.factor * value!r} {display.unit}", kinds[0]) == pytest.approx(value)


@pytest.mark.parametrize(
    "value", ["deg", "", "3", "3 furlong", "nan deg", "inf deg", "1e999 deg", "1,5 deg", True, None, 3]
)
def test_anything_else_is_refused(value):
    with pytest.raises(ValueError, match=r"angle|unit"):
        parse_quantity(value, "angle")


@pytest.mark.parametrize(
    ("value", "kind", "suggested"),
    [(0.05, "ratio", '"5 %"'), ("0.05", "ratio", '"5 %"'), (5, "ratio", '"5 %"'), (1.0, "angle", '"1.0 deg"')],
)
def test_a_number_without_a_unit_is_told_what_it_may_mean(value, kind, suggested):
    with pytest.raises(ValueError, match=f"has no unit.*{suggested}"):
        parse_quantity(value, kind)
