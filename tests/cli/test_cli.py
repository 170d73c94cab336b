import json
import subprocess
import sys

import numpy as np
import pytest

from aerotube import compensation, flight, results, scenario
from aerotube.cli import app
from aerotube.commands.common import compiled, progress
from aerotube.errors import ComputationError
from aerotube.preparation import prepare
from aerotube.results import CALM

SMALL = ["--horizon", "0.1", "--runs", "3", "--seeds", "2"]


def aerotube(capsys, *arguments):
    """Run the command line in this process: exit code, what it printed, what it complained about."""
    with pytest.raises(SystemExit) as ended:
        app([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return ended.value.code, printed.out, printed.err


def one_sentence(errors: str) -> bool:
    return errors.startswith("aerotube: ") and errors.count("\n") == 1 and "Traceback" not in errors


@pytest.mark.parametrize("command", [[], ["init"], ["run"], ["report"], ["check"], ["falsify"]])
def test_help_explains_every_command(capsys, command):
    code, out, _ = aerotube(capsys, *command, "--help")
    assert code == 0
    assert "Usage" in out


def test_the_bare_command_shows_what_there_is(capsys):
    code, out, _ = aerotube(capsys)
    assert code == 0
    for command in ("init", "run", "report", "check"):
        assert command in out


def test_it_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "aerotube", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"aerotube {__import__('aerotube').__version__}\n")


def test_help_loads_nothing_heavy():
    heavy = "{'numpy', 'numba', 'scipy', 'xarray', 'matplotlib', 'plotly'}"
    code = f"import sys, aerotube.cli; print(*{heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_init_writes_the_built_in_scenario_and_spares_what_is_there(capsys, tmp_path):
    file = tmp_path / "mine.toml"
    assert aerotube(capsys, "init", file)[0] == 0
    assert file.read_text(encoding="utf-8") == scenario.built_in_text()
    file.write_text("mine")
    code, _, errors = aerotube(capsys, "init", file)
    assert code == 2
    assert one_sentence(errors)
    assert file.read_text() == "mine"
    assert aerotube(capsys, "init", "--force", file)[0] == 0
    assert file.read_text(encoding="utf-8") == scenario.built_in_text()
    code, _, errors = aerotube(capsys, "init", tmp_path / "no" / "folder.toml")
    assert code == 2
    assert one_sentence(errors)


TEXT = scenario.built_in_text()
MISTAKES = {
    "unknown key": (TEXT.replace("xcg", "xgc", 1), [], "unknown key"),
    "wrong unit": (TEXT.replace("19.3 deg", "19.3 kg"), [], "no unit of angle"),
    "wrong type": (TEXT.replace("throttle = 0.75", 'throttle = "0.75"'), [], "must be a number"),
    "zero width": (TEXT.replace('q = "0.5 deg/s"', 'q = "0 deg/s"'), [], "greater than 0"),
    "negative width": (TEXT.replace('q = "0.5 deg/s"', 'q = "-1 deg/s"'), [], "greater than 0"),
    "nominal starts outside the tables": (TEXT.replace("19.3 deg", "60 deg"), [], "angle of attack"),
    "nominal leaves the tables": (TEXT.replace("xcg = 0.30", "xcg = 0.45"), [], "outside"),
    "control beyond its limit": (TEXT.replace('"-5.3 deg"', '"-25 deg"'), [], "beyond its limits of -20 to 20 deg"),
    "throttle beyond its limit": (TEXT.replace("throttle = 0.75", "throttle = 1.5"), [], "beyond its limits of 0 to 1"),
    "horizon of broken beats": (TEXT, ["--horizon", "0.12"], "whole number of beats"),
    "unknown aircraft": (TEXT.replace('model = "f16"', 'model = "f17"'), [], "f17"),
    "unknown solver": (TEXT.replace('backend = "aerotube"', 'backend = "oracle"'), [], "oracle"),
    "option out of range": (TEXT, ["--runs", "0"], "draws.runs"),
    "option of the wrong type": (TEXT, ["--runs", "many"], "--runs"),
    "unknown choice": (TEXT, ["--algorithm", "magic"], "decoupled"),
    "negative noise": (TEXT, ["--noise", "-1"], "--noise -1: flight.noise"),
    "no horizon": (TEXT, ["--horizon", "0"], "--horizon 0: nominal.horizon"),
    "unknown option": (TEXT, ["--fast"], "; see: aerotube run --help"),
    "missing nominal file": (
        TEXT[: TEXT.index("[nominal.state]")].replace('"constant-controls"', '"file"\nfile = "gone.csv"', 1)
        + TEXT[TEXT.index("[disturbance]") :],
        [],
        "gone.csv",
    ),
}


@pytest.mark.parametrize(("text", "options", "words"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_ends_in_one_sentence_and_writes_nothing(capsys, tmp_path, text, options, words):
    file = tmp_path / "scenario.toml"
    file.write_text(text, encoding="utf-8")
    code, out, errors = aerotube(capsys, "run", file, "--out", tmp_path / "out", *options)
    assert code == 2
    assert words in errors
    assert one_sentence(errors)
    assert out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["scenario.toml"]


def test_a_missing_scenario_is_a_mistake(capsys, tmp_path):
    code, _, errors = aerotube(capsys, "run", tmp_path / "gone.toml", "--out", tmp_path / "out")
    assert (code, one_sentence(errors), "gone.toml" in errors) == (2, True, True)
    assert list(tmp_path.iterdir()) == []


def test_an_out_folder_that_cannot_be_is_a_mistake(capsys, tmp_path):
    (tmp_path / "file").write_text("in the way")
    code, _, errors = aerotube(capsys, "run", *SMALL, "--out", tmp_path / "file" / "out")
    assert (code, one_sentence(errors), "out folder" in errors) == (2, True, True)
    assert (tmp_path / "file").read_text() == "in the way"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A whole run, small."""
    folder = tmp_path_factory.mktemp("run") / "out"
    command = [sys.executable, "-m", "aerotube", "run", *SMALL, "--out", str(folder)]
    return subprocess.run(command, capture_output=True, text=True, check=False), folder


def test_a_run_writes_everything(finished):
    done, folder = finished
    assert done.returncode == 0, done.stderr
    assert {path.name for path in folder.iterdir()} == {"results.nc", "summary.json", "report.html", "figures"}
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["seeds"], summary["runs_per_seed"], summary["horizon_s"], summary["beats"]) == (2, 3, 0.1, 2)
    assert (summary["complete"], summary["problems"], summary["feasible_beats"]) == (True, [], 2)
    for suffix in ("", "_noise", "_estimator"):
        for controller in ("none", "compensated", "lqr"):
            assert summary[f"mean_upper_error{suffix}"][controller]["mean"] > 0
    assert 0 < summary["reduction"]["mean"] < 1
    assert f"{summary['mean_upper_error']['compensated']['mean']:.3f}" in done.stdout


def test_the_written_dataset_holds_what_the_metric_says(finished):
    dataset = results.read(finished[1] / "results.nc")
    scale = np.array([0.01] + 7 * [180 / np.pi])
    metric = np.sqrt(((dataset["error"].values * scale) ** 2).mean(axis=-1))
    np.testing.assert_allclose(metric.max(axis=2), dataset["upper_metric"].isel(seed=0).values)
    command = dataset["command"].values
    assert np.all(command >= dataset["control_lower"].values - 1e-12)
    assert np.all(command <= dataset["control_upper"].values + 1e-12)
    assert json.loads(dataset.attrs["scenario_overrides"])["draws.runs"] == 3


def test_the_report_is_drawn_again_from_the_results(capsys, finished, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr("aerotube.report.write", lambda dataset, folder: drawn.append((dataset, folder)))
    code, _, _ = aerotube(capsys, "report", finished[1] / "results.nc", "--out", tmp_path / "new")
    assert code == 0
    [(dataset, folder)] = drawn
    assert dataset.identical(results.read(finished[1] / "results.nc"))
    assert folder == tmp_path / "new"


def test_results_that_are_not_there_cannot_be_drawn(capsys, tmp_path):
    code, _, errors = aerotube(capsys, "report", tmp_path / "results.nc")
    assert (code, one_sentence(errors)) == (2, True)


@pytest.fixture
def quick(monkeypatch):
    """Everything but the laws, which fail as the test wants, and the drawing."""
    monkeypatch.setattr("aerotube.report.write", lambda dataset, folder: None)

    def fail(error):
        def synthesise(*_, **__):
            raise error

        monkeypatch.setattr(compensation, "synthesise", synthesise)

    return fail


def test_a_computed_failure_keeps_the_rest_and_is_told(capsys, tmp_path, quick):
    quick(ComputationError("beat 1: there is no shape"))
    code, _, errors = aerotube(capsys, "run", *SMALL, "--noise", "0", "--out", tmp_path)
    assert code == 1
    assert "beat 1: there is no shape" in errors
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["complete"], len(summary["problems"])) == (False, 2)
    assert summary["mean_upper_error"]["none"]["mean"] > 0
    assert summary["mean_upper_error"]["compensated"]["mean"] is None
    assert summary["mean_upper_error"]["lqr"]["mean"] > 0


def test_a_diverged_run_is_named_counted_and_kept(capsys, tmp_path, quick):
    quick(ComputationError("no laws here"))
    text = TEXT.replace('alpha = "0.5 deg"', 'alpha = "40 deg"').replace('p = "1 deg/s"', 'p = "400 deg/s"')
    text = text.replace('q = "0.5 deg/s"', 'q = "300 deg/s"')
    (tmp_path / "wild.toml").write_text(text, encoding="utf-8")
    options = ["--runs", "10", "--seeds", "2", "--horizon", "1", "--out", tmp_path / "out"]
    assert aerotube(capsys, "run", tmp_path / "wild.toml", *options)[0] == 1
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    lost = [problem for problem in summary["problems"] if "diverged in beat" in problem]
    assert lost
    assert all("run " in problem and "of seed " in problem for problem in lost)
    assert len(lost) == len(set(lost))
    dataset = results.read(tmp_path / "out" / "results.nc")
    told = (
        dataset["diverged"].sel(controller="lqr").sum()
        + dataset["diverged"].sel(controller="none", condition=CALM).sum()
    )
    assert len(lost) == int(told)
    assert np.isfinite(dataset["upper_metric"].sel(controller="none")).all()


def test_an_interruption_keeps_what_was_finished(capsys, tmp_path, quick, monkeypatch):
    quick(ComputationError("no laws here"))
    flown = []
    real = flight.simulate

    def simulate(*arguments, **options):
        if flown:
            raise KeyboardInterrupt
        flown.append(True)
        return real(*arguments, **options)

    monkeypatch.setattr(flight, "simulate", simulate)
    monkeypatch.setattr(flight, "best_lqr", simulate)
    code, _, errors = aerotube(capsys, "run", *SMALL, "--out", tmp_path)
    assert code == 130
    assert "interrupted" in errors
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["complete"], summary["interrupted"]) == (False, True)
    dataset = results.read(tmp_path / "results.nc")
    assert bool(dataset["flown"].sel(controller="none", condition=CALM))
    assert int(dataset["flown"].sum()) == 1


@pytest.mark.parametrize("where", ["aerotube.preparation.prepare", "aerotube.compensation.synthesise"])
def test_an_interruption_before_anything_is_finished_leaves_nothing(capsys, tmp_path, monkeypatch, where):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(where, interrupted)
    monkeypatch.setattr("aerotube.job.prepare", interrupted if where.endswith("prepare") else prepare)
    code, _, errors = aerotube(capsys, "run", *SMALL, "--out", tmp_path / "a" / "out")
    assert code == 130
    assert errors.splitlines()[-1] == "aerotube: interrupted before anything was finished; nothing was written"
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_while_writing_leaves_whole_files(capsys, tmp_path, quick, monkeypatch):
    quick(ComputationError("no laws here"))

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("aerotube.report.write", interrupted)
    code, _, errors = aerotube(capsys, "run", *SMALL, "--noise", "0", "--out", tmp_path)
    assert code == 130
    assert "interrupted while writing" in errors
    assert {path.name for path in tmp_path.iterdir()} == {"results.nc", "summary.json"}


def test_an_error_nobody_foresaw_is_shown_but_keeps_what_was_finished(tmp_path, quick):
    quick(ZeroDivisionError("a defect"))
    with pytest.raises(ZeroDivisionError):
        app(["run", *SMALL, "--out", str(tmp_path)])
    assert json.loads((tmp_path / "summary.json").read_text())["complete"] is False


def test_certificates_of_a_run_are_checked_offline(capsys, tmp_path):
    assert aerotube(capsys, "run", *SMALL, "--no-estimator", "--certificates", "--out", tmp_path)[0] == 0
    files = sorted((tmp_path / "certificates" / "noise").iterdir())
    assert [file.name for file in files] == [
        f"beat_{beat:03d}_{part}.json" for beat in range(2) for part in ("lateral", "longitudinal")
    ]
    code, out, _ = aerotube(capsys, "check", *files)
    assert code == 0
    assert out.count(": holds") == 4
    code, out, _ = aerotube(capsys, "check", tmp_path)
    assert (code, out.count(": holds"), "8 of 8 certificates hold." in out) == (0, 8, True)
    code, _, errors = aerotube(capsys, "check", tmp_path / "figures")
    assert (code, one_sentence(errors), "holds no certificates" in errors) == (2, True, True)
    code, out, _ = aerotube(capsys, "check", files[0])
    assert (code, "The certificate holds." in out) == (0, True)

    spoiled = tmp_path / "spoiled.json"
    content = json.loads(files[0].read_text())
    blocks = content["constraints"][0]["blocks"]
    blocks[0]["gram"][0][0] = (float.fromhex(blocks[0]["gram"][0][0]) + 0.1).hex()
    spoiled.write_text(json.dumps(content))
    code, out, _ = aerotube(capsys, "check", spoiled)
    assert (code, "NOT PROVEN" in out) == (1, True)
    code, out, _ = aerotube(capsys, "check", tmp_path)
    assert (code, "8 of 9 certificates hold." in out) == (1, True)


@pytest.mark.parametrize("text", [None, "no JSON", "{}"])
def test_what_is_no_certificate_is_a_mistake(capsys, tmp_path, text):
    file = tmp_path / "certificate.json"
    if text is not None:
        file.write_text(text)
    code, _, errors = aerotube(capsys, "check", file)
    assert code == 2
    assert one_sentence(errors)
    assert "certificate.json" in errors


def test_what_is_compiled_is_known_by_the_compilers_own_files(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not compiled()
    (tmp_path / "module").mkdir()
    (tmp_path / "module" / "kernel.nbi").touch()
    assert compiled()


def test_a_first_run_says_that_it_compiles(capsys, monkeypatch):
    monkeypatch.setattr("aerotube.commands.common.compiled", lambda: False)
    with progress() as tell:
        for words in ("tubes", "tubes: laws", "tubes: flights"):
            tell(words, 0.0)
    assert ["compiling" in line for line in capsys.readouterr().err.splitlines()] == [True, True, False]
