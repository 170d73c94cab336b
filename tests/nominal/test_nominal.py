import numpy as np
import pytest

from aerotube.errors import InputError
from aerotube.nominal import Nominal, constant_controls, from_trim, read, write
from tests.samples import TABLE2_CONTROL, aircraft, table2, table2_state


def test_constant_controls_hold_and_step():
    nominal = table2(10)
    assert nominal.beats == 10
    np.testing.assert_allclose(nominal.times, 0.05 * np.arange(11))
    assert (nominal.controls == TABLE2_CONTROL).all()
    np.testing.assert_allclose(np.linalg.norm(nominal.states[:, 3:7], axis=1), 1.0, atol=1e-12)


def test_a_trimmed_aircraft_keeps_its_air_data():
    nominal = from_trim(aircraft(), 185.0, 3000.0, dt=0.05, beats=40)
    speed = np.linalg.norm(nominal.states[:, :3], axis=1)
    np.testing.assert_allclose(speed, 185.0, atol=1e-4)
    np.testing.assert_allclose(nominal.states[:, 12], 3000.0, atol=1e-2)
    np.testing.assert_allclose(nominal.states[:, 7:10], 0.0, atol=1e-5)


def test_a_turn_keeps_turning():
    rate = np.radians(5.0)
    nominal = from_trim(aircraft(), 200.0, 3000.0, turn_rate=rate, dt=0.05, beats=40)
    velocity = np.diff(nominal.states[:, 10:12], axis=0) / 0.05
    heading = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    np.testing.assert_allclose(np.diff(heading) / 0.05, rate, rtol=1e-2)


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
def test_files_read_back_what_was_written(tmp_path, suffix):
    nominal = table2(10)
    path = tmp_path / f"nominal{suffix}"
    write(path, nominal, aircraft())
    back = read(path, aircraft())
    np.testing.assert_allclose(back.states, nominal.states, rtol=1e-15, atol=1e-15)
    np.testing.assert_array_equal(back.controls, nominal.controls)
    assert back.dt == pytest.approx(0.05, rel=1e-12)
    assert list(tmp_path.iterdir()) == [path]


def spoil(path, change):
    lines = path.read_text().splitlines()
    path.write_text("\n".join(change(lines)) + "\n")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda x: [x[0].replace("throttle", "thrust"), *x[1:]], r"lacks columns: throttle; it needs.*throttle \(1\)"),
        (lambda x: [*x[:4], x[4].replace(x[4].split(",")[0], "0.151"), *x[5:]], "not evenly spaced"),
        (lambda x: [*x[:3], x[3] + ",1", *x[4:]], "row 2 of"),
        (lambda x: [*x[:3], "fast" + x[3][x[3].index(",") :], *x[4:]], "no number"),
        (lambda x: x[:2], "at least two"),
        (lambda x: [], "empty|lacks columns"),
    ],
)
def test_a_spoiled_file_is_named_and_explained(tmp_path, change, words):
    path = tmp_path / "nominal.csv"
    write(path, table2(10), aircraft())
    spoil(path, change)
    with pytest.raises(InputError, match=words):
        read(path, aircraft())


def test_missing_and_strange_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no file"):
        read(tmp_path / "nominal.csv", aircraft())
    (tmp_path / "nominal.xls").write_text("")
    with pytest.raises(InputError, match="neither"):
        read(tmp_path / "nominal.xls", aircraft())
    (tmp_path / "nominal.nc").write_text("not a netCDF file")
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path / "nominal.nc", aircraft())


def test_a_nominal_outside_limits_or_tables_is_refused():
    control = TABLE2_CONTROL.copy()
    control[0] = np.radians(-21.0)
    with pytest.raises(InputError, match="elevator"):
        constant_controls(aircraft(), table2_state(), control, 0.05, 2).check(aircraft())
    state = table2_state()
    state[:3] = 185.0 * np.array([np.cos(1.0), 0.0, np.sin(1.0)])
    with pytest.raises(InputError, match="outside the aircraft's model"):
        constant_controls(aircraft(), state, TABLE2_CONTROL, 0.05, 2)


def test_shapes_that_do_not_go_together_are_refused():
    with pytest.raises(InputError, match="one more state"):
        Nominal(0.05, np.zeros((3, 13)), np.zeros((3, 4)))
    with pytest.raises(InputError, match="positive"):
        Nominal(0.0, np.zeros((3, 13)), np.zeros((2, 4)))
    with pytest.raises(InputError, match="finite"):
        Nominal(0.1, np.full((3, 13), np.nan), np.zeros((2, 4)))
