"""Fig. 7: the aerodynamic coefficients over angle of attack."""

from __future__ import annotations

import numpy as np

from aerotube import job
from aerotube.errors import ComputationError
from aerotube.report import coefficients_figure
from aerotube.results import build
from aerotube.studies.bench import Bench
from aerotube.studies.outcome import Outcome, compare

_WORDS = {
    "CD": "drag",
    "CL": "lift",
    "Cm": "pitching moment",
    "CY": "side force",
    "Cl": "rolling moment",
    "Cn": "yawing moment",
}


def study(bench: Bench) -> Outcome:
    """Draw the coefficients of the aircraft flown."""
    dataset = build(job.new_record(bench.prepared))
    figure = coefficients_figure(dataset)
    if figure is None:
        raise ComputationError("the aircraft has no tables of coefficients")
    names = [f"coefficient_{name}" for name in _WORDS]
    dataset = dataset[["coefficient_alpha", *names]]
    alpha = np.degrees(dataset["coefficient_alpha"].values)
    rows = [
        compare("alpha_from", "first angle of attack", -10.0, float(alpha[0])),
        compare("alpha_to", "last angle of attack", 25.0, float(alpha[-1])),
    ]
    bends = {}
    for name, words in _WORDS.items():
        values = dataset[f"coefficient_{name}"].values
        line = np.polynomial.Polynomial.fit(alpha, values, 1)(alpha)
        bends[name] = float(np.sqrt(np.mean((values - line) ** 2)) / max(np.ptp(values), 1e-6))
        rows.append(
            compare(
                f"nonlinearity_{name}",
                f"{words} coefficient: rms departure from a straight line over its range",
                None,
                bends[name],
                "1",
                "the paper prints a curve, no numbers",
            )
        )
    most = max(bends, key=lambda name: bends[name])
    return Outcome(
        dataset=dataset,
        figure=figure,
        caption="Coefficients about the centre of gravity of the scenario; drag and lift in wind axes (Fig. 7).",
        compared=tuple(rows),
        verdict=(
            f"The F-16's coefficients over the paper's range; the {_WORDS[most]} is the least linear "
            f"({bends[most]:.0%} of its range off a straight line); the paper's own aircraft is not published."
        ),
        notes=(
            "The paper's tables are not published, and its figure has no numbers to read off: curves can be "
            "compared by eye only. Every difference between the paper's numbers and ours in the other studies "
            "begins here.",
            "The lateral coefficients are at 5 degrees of sideslip, as the paper's; the side force of this model does "
            "not depend on the angle of attack.",
        ),
    )
