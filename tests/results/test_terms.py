"""Laws in the results: evaluated from the file by a reader that knows nothing of the package."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from aerotube import results
from aerotube.compensation import SynthesisSettings, design
from tests.conftest import HALVES
from tests.samples import BOX, HALF_WIDTHS, aircraft, table2

BEATS = 2


def evaluated(dataset, law, beat, x):
    """What the file's description of a law says, written anew: increments (4,) at an error (8,)."""
    own = dataset.sel(law=law, beat=beat)
    total = np.zeros(4)
    for part in range(dataset.sizes["part"]):
        states = dataset["part_state"].values[part].tolist()
        inside = np.isin(dataset["state"].values, states)
        distance = 1.0
        if "reach" in dataset:
            distance = max(1.0, np.linalg.norm(own["reach"].values @ np.where(inside, x, 0.0)))
        terms = np.prod((x / distance) ** own["exponent"].values, axis=1)
        ours = (own["exponent"].values * inside).any(axis=1)
        total += distance * (own["coefficient"].values * ours) @ terms
    return np.clip(total, own["increment_lower"].values, own["increment_upper"].values)


@pytest.mark.parametrize(("degree", "saturation"), [(1, 1.0), (2, 1.0), (3, 4.0)])
def test_a_law_can_be_evaluated_from_its_file(record, tmp_path, degree, saturation):
    made = design(
        aircraft(), table2(BEATS), BOX, SynthesisSettings(law_degree=degree, saturation=saturation, noise_weight=1.0)
    ).law
    beats = len(record.nominal_controls)

    def whole(array):
        return None if array is None else np.concatenate([array, np.zeros((beats - BEATS, *array.shape[1:]))])

    record.laws["noise"] = replace(
        record.laws["noise"],
        parts=HALVES,
        gains=whole(made.gains),
        coefficients=whole(made.coefficients),
        exponents=made.exponents,
        coordinates=made.coordinates.kind,
        room=whole(made.room),
        reach=whole(made.unwhitening),
    )
    results.write(results.build(record), tmp_path / "results.nc")
    with xr.open_dataset(tmp_path / "results.nc") as dataset:
        assert (dataset["error_coordinates"] == "relative").all()
        rng = np.random.default_rng(degree)
        for beat in range(BEATS):
            for scale in (0.3, 1.0, 5.0):
                x = scale * rng.uniform(-1, 1, 8) * HALF_WIDTHS
                np.testing.assert_allclose(evaluated(dataset, "noise", beat, x), made.increment(beat, x), rtol=1e-10)
                linear = record.laws["noise_free"].gains[beat] @ x
                np.testing.assert_allclose(evaluated(dataset, "noise_free", beat, x), linear, rtol=1e-10)


def test_monomials_are_named_with_their_units(record):
    record.laws["noise"] = replace(
        record.laws["noise"],
        coefficients=np.ones((len(record.nominal_controls), 4, 2)),
        exponents=np.array([[1, 0, 0, 0, 0, 0, 0, 0], [1, 2, 0, 0, 0, 0, 0, 0]]),
    )
    dataset = results.build(record)
    assert dataset["monomial"].values.tolist()[-1] == "V alpha^2"
    assert dataset["monomial_units"].sel(monomial="V alpha^2") == "(m/s) rad^2"
    assert dataset["monomial_units"].sel(monomial="V") == "m/s"
    assert (dataset["coefficient"].sel(law="noise", monomial="V alpha^2") == 1.0).all()
    assert (dataset["coefficient"].sel(law="noise_free", monomial="V alpha^2") == 0.0).all()
