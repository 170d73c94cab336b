"""How the tests run, and a small made-up run for the tests of what is done with results."""

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from aerotube import scenario
from aerotube.results import CALM, ESTIMATOR, NOISE, Case, Law, Record, provenance

# No test asserts a time: machines are shared, and the first example may compile something.
settings.register_profile("house", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("house")

BEATS, SEEDS, RUNS = 12, 3, 5
HALVES = (("longitudinal", (0, 1, 2, 3)), ("lateral", (4, 5, 6, 7)))


def made_up_law(rng: np.random.Generator, certificate: str = "sampled") -> Law:
    shape = (BEATS, 2)
    root = np.eye(4) + 0.2 * rng.standard_normal((*shape, 4, 4))
    widths = np.array([[5.0, 0.009, 0.009, 0.017], [0.009, 0.017, 0.009, 0.017]])
    factor = root / widths[:, None, :]
    shapes = np.swapaxes(factor, -1, -2) @ factor
    nominal_rho = 1.0 + rng.random(shape)
    gains = rng.standard_normal((BEATS, 4, 8))
    return Law(
        parts=HALVES,
        initial_shape=np.broadcast_to(np.array([np.diag(1 / w**2) for w in widths]), (*shape, 4, 4)),
        initial_rho=np.full(shape, 4.0),
        terminal_shape=shapes,
        terminal_rho=0.3 * nominal_rho,
        nominal_shape=shapes,
        nominal_rho=nominal_rho,
        metric=shapes,
        size=0.3 * nominal_rho,
        size_nominal=nominal_rho,
        gains=gains,
        coefficients=gains,
        exponents=np.eye(8, dtype=np.int64),
        coordinates="relative",
        room=None,
        reach=None,
        feasible=np.ones(shape, dtype=bool),
        solve_seconds=0.01 + 0.001 * rng.random(shape),
        certificate=np.full(shape, certificate),
        certificate_nominal=np.full(shape, certificate),
        polynomial_size=0.25 * nominal_rho,
        shares=0.05 * nominal_rho[..., None] * np.array([0.1, 0.0, 0.4, 0.3, 0.2]),
        control=0.01 * nominal_rho,
        boundary=np.ones(shape, dtype=bool),
        certify_seconds=0.001 + 0.001 * rng.random(shape),
        sampling={"samples": 400, "confidence": 0.999, "seed": 0, "share": 0.0171},
        settings={"size": "mean-square", "noise_weight": 0.0},
    )


def made_up_case(rng: np.random.Generator, scale: float) -> Case:
    widths = np.array([5.0, 0.009, 0.009, 0.017, 0.009, 0.017, 0.009, 0.017])
    upper = scale * (1.0 + 0.1 * rng.random((SEEDS, BEATS + 1)))
    return Case(
        error=scale * widths * rng.uniform(-1, 1, (RUNS, BEATS + 1, 8)),
        command=np.array([-0.09, 0.75, 0.05, 0.0]) + 0.01 * rng.standard_normal((RUNS, BEATS, 4)),
        upper_metric=upper,
        mean_metric=0.5 * upper,
        diverged=np.zeros((SEEDS, RUNS), dtype=bool),
        outside=np.zeros((SEEDS, RUNS), dtype=bool),
        law="made up",
    )


@pytest.fixture
def record() -> Record:
    """A complete run of twelve beats with two laws and nine cases."""
    rng = np.random.default_rng(0)
    source = scenario.load()
    made = Record(
        times=0.05 * np.arange(BEATS + 1),
        nominal_error_states=rng.standard_normal((BEATS + 1, 8)),
        nominal_controls=np.tile([-0.09, 0.75, 0.05, 0.0], (BEATS, 1)),
        nominal_states=rng.standard_normal((BEATS + 1, 13)),
        full_state_names=tuple(f"x{i}" for i in range(13)),
        full_state_units=("1",) * 13,
        half_widths=np.array(source.scenario.disturbance.half_widths),
        control_lower=np.array([-0.35, 0.0, -0.375, -0.52]),
        control_upper=np.array([0.35, 1.0, 0.375, 0.52]),
        seeds=(1, 2, 3),
        runs=RUNS,
        conditions=(CALM, NOISE, ESTIMATOR),
        provenance=provenance(source),
        coefficient_alpha=np.radians(np.linspace(-10, 25, 36)),
        coefficients={name: rng.standard_normal(36) for name in ("CD", "CL", "Cm", "CY", "Cl", "Cn")},
    )
    made.laws = {"noise_free": made_up_law(rng), "noise": made_up_law(rng)}
    for condition in made.conditions:
        for controller, scale in (("none", 1.2), ("compensated", 0.3), ("lqr", 0.4)):
            made.cases[controller, condition] = made_up_case(rng, scale)
    return made
