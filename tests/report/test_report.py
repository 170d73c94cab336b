import io
import re

import numpy as np
import pytest

from aerotube import report, results
from aerotube.report.tubes import projection
from aerotube.results import NOISE, summarise
from aerotube.units import DISPLAY

PICTURES = {
    "fig7_coefficients",
    "fig8_tubes",
    "tube_shares",
    "fig9_tracking",
    "fig9_tracking_noise",
    "fig9_tracking_estimator",
}


@pytest.fixture
def dataset(record):
    return results.build(record)


def test_the_whole_report_is_written(dataset, tmp_path):
    report.write(dataset, tmp_path)
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == PICTURES
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in (tmp_path / "figures").iterdir())
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    summary = summarise(dataset)
    assert f"{100 * summary['reduction']['mean']:.1f} %" in page
    assert "Sampled: with a confidence of" in page
    assert dataset.attrs["scenario_sha256"] in page
    # Nothing is fetched: no script, style or picture comes from elsewhere.
    markup = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    assert not re.search(r"""(src|href)\s*=\s*["'](https?:)?//""", markup)
    assert "<link" not in markup
    assert markup.count("data:image/png;base64,") == len(PICTURES)
    assert not re.search(r"<script[^>]+src=", page)


def test_what_was_not_computed_is_left_out(record, tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "fig8_tubes.png").write_text("of an earlier run")
    record.laws.clear()
    record.interrupted = True
    record.problems.append("beat 3 <b>failed</b>")
    for key in [key for key in record.cases if key[1] != NOISE]:
        del record.cases[key]
    report.write(results.build(record), tmp_path)
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == {"fig7_coefficients", "fig9_tracking_noise"}
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "interrupted" in page
    assert "beat 3 &lt;b&gt;failed" in page
    assert 'id="tubes"' not in page


def test_nothing_but_a_nominal_still_makes_a_page(record, tmp_path):
    record.laws.clear()
    record.cases.clear()
    report.write(results.build(record), tmp_path)
    assert (tmp_path / "report.html").stat().st_size > 1000


@pytest.mark.parametrize("pair", [("alpha", "q"), ("V", "theta"), ("beta", "r"), ("phi", "p")])
def test_a_projection_is_the_shadow_of_the_ellipsoid(dataset, record, pair):
    tube = projection(dataset, "noise_free", pair)
    law = record.laws["noise_free"]
    states = ("V", "alpha", "q", "theta", "beta", "p", "r", "phi")
    part = 0 if pair[0] in states[:4] else 1
    rows = [states.index(name) - 4 * part for name in pair]
    rng = np.random.default_rng(1)
    # Points of the ellipsoid x'Ex = rho, by a route of its own: the sphere through the inverse Cholesky factor.
    factor = np.linalg.cholesky(law.terminal_shape[:, part])
    sphere = rng.standard_normal((4000, 4))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    for beat in range(len(tube.times)):
        points = np.sqrt(law.terminal_rho[beat, part]) * np.linalg.solve(factor[beat].T, sphere.T)
        shadow = points[rows] * np.array([[DISPLAY[name].factor] for name in pair])
        inside = np.einsum("ik,ij,jk->k", shadow, np.linalg.inv(tube.terminal[beat]), shadow)
        assert inside.max() <= 1 + 1e-9
        assert inside.max() > 0.98
        reach = np.abs(shadow).max(axis=1)
        extent = [tube.half_extent("terminal", i)[beat] for i in range(2)]
        assert np.all(reach <= np.array(extent) * (1 + 1e-12))
        assert np.all(reach > 0.95 * np.array(extent))


def test_boundaries_lie_on_their_ellipses(dataset):
    tube = projection(dataset, "noise", ("beta", "r"))
    boundary = tube.ellipses("nominal", points=17)
    values = np.einsum("bpi,bij,bpj->bp", boundary, np.linalg.inv(tube.nominal), boundary)
    np.testing.assert_allclose(values, 1.0, rtol=1e-9)


def test_degenerate_ellipses_are_drawn_as_what_they_are(dataset):
    from aerotube.report.tubes import Projection

    P = np.array([[[4.0, 2.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]], [[np.nan, 0.0], [0.0, 1.0]]])
    line, point, gap = Projection(np.arange(3.0), P, P, P).ellipses("terminal")
    np.testing.assert_allclose(line[:, 0], 2 * line[:, 1], atol=1e-12)
    assert line[:, 0].max() == pytest.approx(2.0, rel=1e-2)
    assert np.all(point == 0.0)
    assert np.isnan(gap).all()


def test_an_infeasible_beat_leaves_a_gap(record):
    for name in ("terminal_rho", "size"):
        getattr(record.laws["noise_free"], name)[3, 0] = np.nan
    figure = report.tubes_figure(results.build(record), "noise_free")
    figure.savefig(io.BytesIO(), format="png", dpi=20)
    gaps = [np.isnan(line.get_ydata()).sum() for axes in figure.axes for line in axes.lines]
    assert sum(gaps) == 4  # the half-widths of four longitudinal states at one beat
