import json

import numpy as np
import pytest
import xarray as xr

from aerotube import scenario, verify
from aerotube.commands.falsify import parse_beats, ratio_words
from aerotube.errors import InputError
from tests.cli.test_cli import aerotube, one_sentence


@pytest.fixture
def short(tmp_path):
    """The built-in scenario, two beats long."""
    file = tmp_path / "short.toml"
    text = scenario.built_in_text().replace('horizon = "3 s"', 'horizon = "0.1 s"')
    file.write_text(text, encoding="utf-8")
    return file


def test_every_tube_is_attacked_and_what_was_found_is_written(capsys, tmp_path, short):
    out = tmp_path / "found"
    code, printed, _ = aerotube(
        capsys, "falsify", short, "--samples", 50, "--certificate", "polynomial only", "--out", out
    )
    assert code == 0  # broken or not: they promise no more than their polynomials
    assert "longitudinal, size" in printed
    assert "noise-free law" in printed
    assert f"Written to {out}" in printed.replace("\n", "")
    told = json.loads((out / "falsification.json").read_text(encoding="utf-8"))
    assert told["samples"] == 50
    assert set(told["tightness"]) == {"noise_free", "noise"}
    assert (out / "figures" / "falsification.png").read_bytes().startswith(b"\x89PNG")
    with xr.open_dataset(out / "falsification.nc", engine="h5netcdf") as found:
        assert found.sizes["beat"] == 2
        ratio = found["ratio"].values
        assert np.isfinite(ratio).all()
        for i, law in enumerate(found["law"].values):
            broken = told["violations"][str(law)]
            assert len(broken) == (ratio[i] > 1 + 1e-9).sum()
            for row in told["tightness"][str(law)]:
                values = found["ratio"].sel(law=law, part=row["part"], form=row["form"]).values
                assert row["median"] == pytest.approx(np.median(values))
                assert row["max"] == pytest.approx(values.max())
            for one in broken:
                assert one["ratio"] == pytest.approx(
                    float(found["ratio"].sel(law=law, beat=one["beat"], part=one["part"], form=one["form"]))
                )
                assert "errors" in one["point"]
                assert "mass" in one["point"]


def test_a_tube_that_promises_more_and_is_broken_is_a_failure(capsys, tmp_path, short, monkeypatch):
    """Tubes of polynomials, passed off as sampled."""
    monkeypatch.setattr(verify.falsification, "PROMISING", ("polynomial only",))
    monkeypatch.setattr("aerotube.results.falsified.PROMISING", ("polynomial only",))
    code, printed, _ = aerotube(
        capsys, "falsify", short, "--samples", 50, "--certificate", "polynomial only", "--beats", "1", "--out", tmp_path
    )
    assert code == 1
    assert "times the tube with errors" in printed
    told = json.loads((tmp_path / "falsification.json").read_text(encoding="utf-8"))
    assert {one["beat"] for one in told["violations"]["noise_free"]} == {1}
    assert told["refuted"]["noise_free"] > 0


def test_an_interruption_keeps_what_was_finished(capsys, tmp_path, short, monkeypatch):
    whole = verify.falsify

    def cut(*arguments, **options):
        def interrupt(done, total):
            raise KeyboardInterrupt

        return whole(*arguments, **(options | {"progress": interrupt, "workers": 1}))

    monkeypatch.setattr(verify, "falsify", cut)
    code, printed, errors = aerotube(capsys, "falsify", short, "--samples", 50, "--out", tmp_path)
    assert code == 130
    assert "interrupted" in errors
    assert "longitudinal, size" in printed
    told = json.loads((tmp_path / "falsification.json").read_text(encoding="utf-8"))
    assert told["interrupted"]
    assert list(told["tightness"]) == ["noise_free"]


def test_a_search_cut_short_at_once_leaves_nothing(capsys, tmp_path, short, monkeypatch):
    def cut(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(verify, "falsify", cut)
    monkeypatch.chdir(tmp_path)
    code, _, errors = aerotube(capsys, "falsify", short, "--samples", 50)
    assert code == 130
    assert "nothing was written" in errors
    assert [path.name for path in tmp_path.iterdir()] == ["short.toml"]


def test_ratios_near_one_keep_what_they_differ_by():
    assert [ratio_words(value) for value in (None, 0.9901, 1.0, 1.0 + 2.3e-7, 0.99999)] == [
        "–", "0.990", "1.000", "1+2.3e-07", "1-1.0e-05",
    ]  # fmt: skip


def test_beats_are_read():
    assert parse_beats("all", 4) == [0, 1, 2, 3]
    assert parse_beats("0-2, 2,5", 6) == [0, 1, 2, 5]


@pytest.mark.parametrize("text", ["6", "x", "3-1", "0-6", "", "-1", "1.5"])
def test_beats_that_there_are_not_are_refused(text):
    with pytest.raises(InputError, match="beats"):
        parse_beats(text, 6)


@pytest.mark.parametrize("wrong", [["--beats", "7"], ["--certificate", "believed"], ["--samples", "0"]])
def test_mistakes_are_one_sentence(capsys, tmp_path, short, wrong):
    out = tmp_path / "found"
    code, _, errors = aerotube(capsys, "falsify", short, "--out", out, *wrong)
    assert code == 2
    assert one_sentence(errors.splitlines()[-1] + "\n")
    assert not out.exists()
