import json

import numpy as np
import pytest

from aerotube import results
from aerotube.errors import InputError
from aerotube.results import CALM, ESTIMATOR, NOISE


def test_a_dataset_survives_its_file(record, tmp_path):
    dataset = results.build(record)
    results.write(dataset, tmp_path / "results.nc")
    assert results.read(tmp_path / "results.nc").identical(dataset)


def test_every_number_has_a_unit_or_is_a_count(record):
    dataset = results.build(record)
    for name, variable in dataset.variables.items():
        if variable.dtype.kind == "f":
            assert variable.attrs.get("units"), name


def test_cases_are_found_by_their_labels(record):
    dataset = results.build(record)
    case = record.cases["lqr", NOISE]
    at = {"controller": "lqr", "condition": NOISE}
    np.testing.assert_array_equal(dataset["error"].sel(at | {"state": "theta"}), case.error[..., 3])
    np.testing.assert_array_equal(dataset["command"].sel(at | {"control": "rudder"}), case.command[..., 3])
    np.testing.assert_array_equal(dataset["upper_metric"].sel(at | {"seed": 2}), case.upper_metric[1])
    assert list(dataset["part_state"].sel(part="lateral").values) == ["beta", "p", "r", "phi"]


def test_provenance_is_in_the_file(record):
    attributes = results.build(record).attrs
    for key in ("schema_version", "aerotube_version", "scenario_text", "scenario_sha256", "python_version", "created"):
        assert attributes[key], key
    assert "numpy" in json.loads(attributes["library_versions"])


def test_the_summary_is_what_the_cases_give(record):
    summary = results.summarise(results.build(record))
    assert (summary["seeds"], summary["runs_per_seed"], summary["beats"]) == (3, 5, 12)
    assert (summary["seed_values"], summary["feasible_beats"], summary["complete"]) == ([1, 2, 3], 12, True)
    assert summary["horizon_s"] == pytest.approx(0.6)
    none, compensated = (record.cases[c, CALM].upper_metric.mean(axis=1) for c in ("none", "compensated"))
    ratio = 1 - compensated / none
    assert summary["mean_upper_error"]["none"]["mean"] == pytest.approx(none.mean())
    assert summary["mean_upper_error"]["none"]["sd"] == pytest.approx(np.sqrt(((none - none.mean()) ** 2).sum() / 2))
    assert summary["reduction"] == pytest.approx({"mean": ratio.mean(), "sd": ratio.std(ddof=1)})
    noisy = record.cases["lqr", NOISE].upper_metric.mean()
    assert summary["mean_upper_error_noise"]["lqr"]["mean"] == pytest.approx(noisy)
    seconds = np.concatenate([law.solve_seconds.ravel() for law in record.laws.values()])
    assert summary["solve_ms"]["median"] == pytest.approx(1e3 * np.median(seconds))
    assert summary["solve_ms"]["p99"] == pytest.approx(1e3 * np.quantile(seconds, 0.99))


def test_lost_runs_are_counted(record):
    record.cases["lqr", NOISE].diverged[1, [0, 3]] = True
    record.cases["lqr", NOISE].outside[:, 3] = True
    summary = results.summarise(results.build(record))
    assert summary["diverged_runs"][NOISE] == {"none": 0, "compensated": 0, "lqr": 2}
    assert summary["outside_runs"][NOISE]["lqr"] == 3
    assert sum(summary["diverged_runs"][CALM].values()) == 0


def test_a_beat_counts_as_feasible_when_all_of_it_is(record):
    record.laws["noise"].feasible[3, 1] = False
    record.laws["noise_free"].feasible[4, 0] = False
    record.laws["noise_free"].feasible[4, 1] = False
    summary = results.summarise(results.build(record))
    assert summary["feasible_beats"] == 10
    assert summary["laws"]["noise_free"]["feasible_beats"] == 11


def test_what_was_not_reached_is_missing_and_says_so(record, tmp_path):
    del record.cases["lqr", NOISE]
    for controller in ("none", "compensated", "lqr"):
        del record.cases[controller, ESTIMATOR]
    record.interrupted = True
    dataset = results.build(record)
    assert not bool(dataset["flown"].sel(controller="lqr", condition=NOISE))
    assert np.isnan(dataset["error"].sel(controller="lqr", condition=NOISE)).all()
    summary = results.summarise(dataset)
    assert (summary["complete"], summary["interrupted"]) == (False, True)
    assert summary["mean_upper_error_noise"]["lqr"] == {"mean": None, "sd": None}
    assert summary["reduction_noise"]["mean"] is not None
    assert summary["reduction_estimator"] == {"mean": None, "sd": None}
    results.write_json(tmp_path / "summary.json", summary)


def test_a_record_of_nothing_yet_still_has_all_keys(record, tmp_path):
    record.laws.clear()
    record.cases.clear()
    summary = results.summarise(results.build(record))
    for key in ("mean_upper_error", "reduction", "reduction_noise", "feasible_beats", "solve_ms"):
        assert key in summary
    results.write_json(tmp_path / "summary.json", summary)


def test_files_of_others_are_refused(record, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        results.read(tmp_path / "results.nc")
    (tmp_path / "text.nc").write_text("not netCDF")
    with pytest.raises(InputError, match="netCDF"):
        results.read(tmp_path / "text.nc")
    dataset = results.build(record)
    results.write(dataset.drop_attrs().assign_attrs(schema_version="2.0", title="a log"), tmp_path / "log.nc")
    with pytest.raises(InputError, match='"a log", not the results of a run'):
        results.read(tmp_path / "log.nc")
    dataset.attrs["schema_version"] = "99.0"
    results.write(dataset, tmp_path / "future.nc")
    with pytest.raises(InputError, match=r"99\.0"):
        results.read(tmp_path / "future.nc")
