import csv
import importlib
import json

import numpy as np
import pytest
from scipy.special import stdtr

from aerotube.cli import app
from aerotube.errors import ComputationError, InputError
from aerotube.studies import STUDIES, job
from aerotube.studies.bench import Bench
from aerotube.studies.outcome import Outcome, compare
from aerotube.studies.page import _number
from aerotube.studies.statistics import paired, spread, welch
from aerotube.studies.steps_time import predicted

QUICK = ("coefficients", "tracking")


def test_every_file_with_a_study_is_in_the_registry():
    from pathlib import Path

    import aerotube.studies

    folder = Path(aerotube.studies.__file__).parent
    files = {path.stem for path in folder.glob("*.py") if "\ndef study(bench: Bench)" in path.read_text("utf-8")}
    assert {one.module for one in STUDIES.values()} == files
    for one in STUDIES.values():
        assert callable(importlib.import_module(f"aerotube.studies.{one.module}").study)


def test_names_of_studies_are_checked_and_put_in_order():
    assert job.chosen(["all"]) == list(STUDIES)
    assert job.chosen(["tracking", "coefficients"]) == ["coefficients", "tracking"]
    with pytest.raises(InputError, match="no study 'traking'"):
        job.chosen(["traking"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("studies")
    done = job.run(QUICK, target, runs=3, seeds=2)
    assert done.problems == []
    assert set(done.verdicts) == set(QUICK)
    return target


def test_progress_never_runs_backwards():
    told = []
    tell = job._telling(lambda words, share: told.append(share), "a", 0.2, 0.5)
    for words, share in (("main", 0.0), ("main", 0.9), ("others", 0.6), ("others", 1.0)):
        tell(words, share)
    assert told == pytest.approx([0.2, 0.65, 0.65, 0.7])


def test_studies_interrupted_at_once_leave_nothing(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(job, "_do", interrupted)
    done = job.run(["tracking"], tmp_path / "out", runs=2, seeds=1)
    assert done.interrupted
    assert list(tmp_path.iterdir()) == []


def test_a_study_writes_its_files(folder):
    import xarray as xr

    for name in QUICK:
        assert (folder / name / "figure.png").read_bytes().startswith(b"\x89PNG")
        with xr.open_dataset(folder / name / "data.nc", engine="h5netcdf") as dataset:
            assert dataset.attrs["scenario_sha256"]
            assert json.loads(dataset.attrs["seeds"]) == [1, 2]
        with open(folder / name / "table.csv", encoding="utf-8") as lines:
            rows = list(csv.DictReader(lines))
        described = json.loads((folder / name / "study.json").read_text("utf-8"))
        assert [row["figure"] for row in rows] == [row["name"] for row in described["compared"]]
        for row in rows:
            if row["ratio"]:
                assert float(row["ratio"]) == pytest.approx(float(row["ours"]) / float(row["paper"]))


def test_the_gathered_file_sets_ours_beside_the_papers(folder):
    gathered = json.loads((folder / "studies.json").read_text("utf-8"))
    assert list(gathered) == list(QUICK)
    for figures in gathered.values():
        for values in figures.values():
            assert set(values) == {"paper", "ours", "ours_sd", "verdict"}
            assert isinstance(values["verdict"], str)
            assert values["verdict"]
            for key in ("paper", "ours", "ours_sd"):
                assert values[key] is None or np.isfinite(values[key])
    tracking = gathered["tracking"]
    assert tracking["mean_upper_error_without"]["paper"] == 0.93
    assert tracking["mean_upper_error_with"]["paper"] == 0.32
    # the published reduction is that of the published errors
    assert tracking["reduction"]["paper"] == pytest.approx(1 - 0.32 / 0.93, abs=0.005)


def test_the_page_holds_every_study_and_stands_alone(folder):
    page = (folder / "studies.html").read_text("utf-8")
    for name in QUICK:
        assert f'id="{name}"' in page
    assert page.count("data:image/png;base64,") == len(QUICK)
    assert "http://" not in page
    assert 'src="http' not in page


def test_what_was_finished_is_kept_when_a_later_study_fails_or_is_stopped(tmp_path, monkeypatch):
    def finished(bench):
        return job_outcome(bench)

    def failing(bench):
        raise ComputationError("it could not be computed")

    def stopped(bench):
        raise KeyboardInterrupt

    doing = {"coefficients": finished, "tubes": failing, "tracking": finished, "methods": stopped}
    for name, function in doing.items():
        monkeypatch.setattr(importlib.import_module(f"aerotube.studies.{name}"), "study", function)
    done = job.run(list(doing), tmp_path, runs=1, seeds=1)
    assert done.interrupted
    assert done.problems == ["tubes: it could not be computed"]
    assert set(json.loads((tmp_path / "studies.json").read_text("utf-8"))) == {"coefficients", "tracking"}
    # a later run adds to them
    monkeypatch.setattr(importlib.import_module("aerotube.studies.methods"), "study", finished)
    assert not job.run(["methods"], tmp_path, runs=1, seeds=1).interrupted
    assert set(json.loads((tmp_path / "studies.json").read_text("utf-8"))) == {"coefficients", "tracking", "methods"}


def job_outcome(bench: Bench) -> Outcome:
    import xarray as xr

    from aerotube.report.style import new_figure

    row = compare("a", "a number", 2.0, [1.0, 3.0])
    return Outcome(xr.Dataset({"a": ("seed", [1.0, 3.0])}), new_figure(2, 2), "made up", (row,), "fine")


def test_the_draws_scale_with_the_disturbance():
    bench = Bench(5, 2)
    larger = bench.scaled_draws(2.0)
    draws = bench.prepared.draws
    np.testing.assert_allclose(larger.initial_error, 2 * draws.initial_error)
    np.testing.assert_allclose(larger.measurement_noise(3), 2 * draws.measurement_noise(3))
    np.testing.assert_allclose(1 / larger.parameters - 1, 2 * (1 / draws.parameters - 1), atol=1e-12)


def test_numbers_beside_the_papers():
    row = compare("a", "a", 0.5, [0.2, 0.3])
    assert (row.ours, row.ratio) == pytest.approx((0.25, 0.5))
    assert row.ours_sd == pytest.approx(np.sqrt(0.005))
    assert row.verdict == "smaller than the paper's"
    assert [_number(value) for value in (2.78e-11, 0.0, 0.25, -2e-4)] == ["0", "0", "0.250", "-0.000200"]
    assert compare("a", "a", None, 1.0).ratio is None
    assert compare("a", "a", 1.0, [1.0, np.nan]).verdict == "not reached"
    assert spread([1.0, 3.0], 1) == "2.0 ± 1.4"


def test_welchs_test_gives_a_published_value():
    # Student's sleep data (Biometrika 6, 1908), as R's t.test(extra ~ group, sleep) publishes its test.
    a = np.array([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0])
    b = np.array([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])
    found = welch(a, b)
    assert (found.statistic, found.degrees) == pytest.approx((-1.8608, 17.776), rel=1e-4)
    assert found.p == pytest.approx(0.07939, rel=1e-4)
    assert not found.significant
    se2 = np.array([a.var(ddof=1) / len(a), b.var(ddof=1) / len(b)])
    statistic = (a.mean() - b.mean()) / np.sqrt(se2.sum())
    degrees = se2.sum() ** 2 / np.sum(se2**2 / (len(a) - 1))
    assert found.statistic == pytest.approx(statistic)
    assert found.degrees == pytest.approx(degrees)
    assert found.p == pytest.approx(2 * stdtr(degrees, -abs(statistic)))
    assert found.difference == pytest.approx(a.mean() - b.mean())


def test_the_model_of_threads():
    serial, parallel = np.array([1.0]), np.array([32.0])
    times = [predicted(serial, parallel, threads)[0] for threads in (1, 2, 8, 16, 32, 64)]
    assert times == pytest.approx([33.0, 17.0, 5.0, 3.0, 2.0, 2.0])
    # programs are whole: five threads are no better than what the longest queue of seven takes
    assert predicted(serial, parallel, 5)[0] == pytest.approx(1.0 + 7.0)


def test_tests_without_spread():
    assert not welch([1.0, 1.0], [1.0, 1.0]).significant
    assert welch([1.0, 1.0], [2.0, 2.0]).significant
    assert paired([1.0, 2.0], [1.0, 2.0]) == 1.0
    a = [0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0]
    b = [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4]
    assert paired(a, b) == pytest.approx(0.002833, rel=1e-3)  # the same data, each patient against himself


def test_the_command_says_what_it_found_and_names_mistakes(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        app(["study", "coefficients", "--runs", "1", "--seeds", "1", "--out", str(tmp_path)])
    assert end.value.code == 0
    assert "coefficients" in capsys.readouterr().out
    assert (tmp_path / "studies.html").is_file()
    with pytest.raises(SystemExit) as end:
        app(["study", "coeficients", "--out", str(tmp_path / "other")])
    assert end.value.code == 2
    assert "no study 'coeficients'" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_progress_is_told_where_the_words_change_or_a_percent_is_done(tmp_path, monkeypatch):
    """A study that tells a thousand times, in four sets of words, of which each is told at most once a percent."""

    def talkative(bench):
        for step in range(1000):
            bench.tell(f"part {step // 250}", step / 1000)
        raise ComputationError("enough was told.")

    monkeypatch.setattr(
        job, "STUDIES", {"talk": type("Talk", (), {"share": 3.0, "__call__": lambda _, b: talkative(b)})()}
    )
    told = []
    done = job.run(["talk"], tmp_path, runs=1, seeds=1, progress=lambda words, share: told.append((words, share)))
    assert done.problems == ["talk: enough was told."]
    assert {words for words, _ in told} == {"talk"} | {f"talk: part {i}" for i in range(4)}
    assert 90 <= len(told) <= 105
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert shares[-1] >= 0.98
