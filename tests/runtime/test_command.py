"""``aerotube fly`` from the command line."""

import json
import re

import pytest
import xarray as xr
from typer.testing import CliRunner

from aerotube.cli import app, cli
from aerotube.runtime import page
from aerotube.scenario import built_in_text


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "short.toml"
    path.write_text(re.sub(r'(?m)^horizon = "3 s"', 'horizon = "0.6 s"', built_in_text()))
    return path


@pytest.fixture(scope="module")
def flown(scenario, tmp_path_factory):
    """A flight without a clock: its folder, and what the command printed."""
    out = tmp_path_factory.mktemp("flown") / "out"
    run = CliRunner().invoke(cli, ["fly", str(scenario), "--speed", "inf", "--out", str(out), "--udp"])
    assert run.exit_code == 0, run.output
    return out, run.output


def refused(capsys, *arguments):
    """The one sentence of a command that ends with exit code 2."""
    with pytest.raises(SystemExit) as left:
        app(["fly", *map(str, arguments)])
    said = capsys.readouterr()
    assert left.value.code == 2
    assert said.out == ""
    assert said.err.count("\n") == 1
    return said.err


def test_a_flight_is_written_and_replayed(flown):
    out, _ = flown
    assert {path.name for path in out.iterdir()} == {"flight.nc", "fly.json", "figures", "report.html"}
    again = CliRunner().invoke(cli, ["fly", "--replay", str(out / "flight.nc")])
    assert again.exit_code == 0, again.output
    assert "same numbers" in again.output


def test_what_is_no_flights_log_is_not_replayed(capsys, scenario, tmp_path):
    path = tmp_path / "results.nc"
    results = xr.Dataset({"command": ("beat", [0.0])}, attrs={"schema_version": "2.0"})
    results.to_netcdf(path, engine="h5netcdf")
    assert f"{path} is no log of a flight" in refused(capsys, scenario, "--replay", path)


def test_a_log_of_another_version_is_not_replayed(capsys, flown, tmp_path):
    with xr.open_dataset(flown[0] / "flight.nc", engine="h5netcdf") as log:
        log.load().assign_attrs(schema_version="1.0").to_netcdf(tmp_path / "old.nc", engine="h5netcdf")
    assert "version 1.0" in refused(capsys, "--replay", tmp_path / "old.nc")


def test_a_replay_takes_nothing_else(capsys, flown, tmp_path):
    out = tmp_path / "elsewhere"
    assert "leave out --out" in refused(capsys, "--replay", flown[0] / "flight.nc", "--out", out)
    assert not out.exists()


def test_a_refused_flight_leaves_no_folder(capsys, scenario, tmp_path):
    out = tmp_path / "a" / "b"
    assert "room for" in refused(capsys, scenario, "--faults", 9999, "--out", out)
    assert not out.parent.exists()


def test_an_interruption_leaves_no_empty_folder(capsys, scenario, tmp_path, monkeypatch):
    def interrupted(flown, folder):
        (folder / "figures").mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr(page, "save", interrupted)
    (tmp_path / "mine").mkdir()
    for out in (tmp_path / "a" / "b", tmp_path / "mine"):
        with pytest.raises(SystemExit) as left:
            app(["fly", str(scenario), "--speed", "inf", "--out", str(out), "--headless"])
        assert left.value.code == 130
        assert "interrupted before the end" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert not any((tmp_path / "mine").iterdir())


def test_a_flight_is_of_whole_manoeuvres_and_says_so(scenario, tmp_path):
    arguments = ["fly", str(scenario), "--speed", "inf", "--duration", "1", "--out", str(tmp_path)]
    said = CliRunner().invoke(cli, arguments).output
    words = "1.2 s of flight (1 s were asked for: whole manoeuvres)"
    assert words in said
    assert words in (tmp_path / "report.html").read_text()
    assert json.loads((tmp_path / "fly.json").read_text())["seconds"] == pytest.approx(1.2)
