"""Margins and containment: into the dataset, out in the summary and the report."""

from dataclasses import replace

import numpy as np
import pytest

from aerotube import report, results
from aerotube.flight import Containment
from aerotube.report.assurance import containment_figure, margins_figure
from aerotube.verify import margins
from tests.conftest import BEATS

VIOLATED = 7


@pytest.fixture
def assured(record):
    random = np.random.default_rng(4)
    closed = 0.4 * random.standard_normal((BEATS, 8, 8)) / np.sqrt(8)
    closed[3] *= 50.0  # not stable by itself
    b, k = random.standard_normal((BEATS, 8, 4)), 0.1 * random.standard_normal((BEATS, 4, 8))
    found = margins(closed - b @ k, b, k, 0.05)
    record.laws = {name: replace(law, margins=found) for name, law in record.laws.items()}
    violated = np.zeros((BEATS, 2, 2), dtype=int)
    violated[5, 1, 1] = VIOLATED
    counted = Containment(
        flown=np.full(BEATS, 15),
        inside=np.full(BEATS, 12),
        outside=np.tile([3, 1, 0, 0], (BEATS, 1)),
        violated=violated,
        worst=np.where(violated > 0, 2.5, 0.4),
    )
    case = record.cases["compensated", "noise-free"]
    record.cases["compensated", "noise-free"] = replace(case, containment=counted)
    return record


def test_margins_and_containment_survive_the_file(assured, tmp_path):
    dataset = results.build(assured)
    results.write(dataset, tmp_path / "results.nc")
    again = results.read(tmp_path / "results.nc")
    found = assured.laws["noise"].margins
    np.testing.assert_array_equal(again["disk_margin"].sel(law="noise"), found.disk)
    np.testing.assert_array_equal(again["delay_margin_all"].sel(law="noise"), found.delay_all)
    assert int(again["containment_violated"].sel(condition="noise-free").sum()) == VIOLATED
    assert again["containment_counted"].values.tolist() == [True, False, False]
    assert results.summarise(again)["containment"] == results.summarise(dataset)["containment"]


def test_the_summary_tells_the_worst_of_the_stable_beats(assured):
    summary = results.summarise(results.build(assured))
    told, found = summary["laws"]["noise"]["margins"], assured.laws["noise"].margins
    assert told["unstable_beats"] == 1
    stable = np.flatnonzero(found.stable)
    assert told["all"]["disk"] == found.disk_all[stable].min()
    for i, name in enumerate(("elevator", "throttle", "aileron", "rudder")):
        assert told[name]["disk"] == found.disk[stable, i].min()
        assert told[name]["at_beat"] != 3
        low = (2 - told[name]["disk"]) / (2 + told[name]["disk"])
        assert told[name]["gain_db"] == pytest.approx(-20 * np.log10(low))
    assert set(summary["containment"]) == {"noise-free"}
    counted = summary["containment"]["noise-free"]
    assert (counted["beats"], counted["started_inside"]) == (15 * BEATS, 12 * BEATS)
    assert counted["violations"]["lateral, ellipsoid"] == VIOLATED
    assert counted["worst"]["lateral, ellipsoid"] == 2.5
    assert counted["outside"]["error"] == 3 * BEATS


def test_the_report_shows_both(assured):
    dataset = results.build(assured)
    for figure in (margins_figure(dataset), containment_figure(dataset)):
        assert figure is not None
        figure.canvas.draw()
    page = report.build_page(dataset, results.summarise(dataset), {})
    assert f'<td class="n">{VIOLATED}</td><td class="n">2.5</td>' in page
    assert "not stable by itself, and has no margin: 1<" in page


def test_without_them_nothing_is_said(record):
    dataset = results.build(record)
    summary = results.summarise(dataset)
    assert summary["containment"] == {}
    assert summary["laws"]["noise"]["margins"] is None
    assert "disk_margin" not in dataset
    assert margins_figure(dataset) is None
    assert containment_figure(dataset) is None
    page = report.build_page(dataset, summary, {})
    assert 'id="margins"' not in page
    assert 'id="containment"' not in page
