"""Random expressions as Taylor models, against ball arithmetic of 300 bits: truncation and rounding together."""

import numpy as np
import pytest

from aerotube.numerics import ModelSpace

flint = pytest.importorskip("flint")
arb = flint.arb

# name: arguments, on Taylor models, on balls; every one defined for all numbers
OPERATIONS = {
    "sum": (2, lambda a, b: a + b, lambda a, b: a + b),
    "difference": (2, lambda a, b: 0.3 - (a - b), lambda a, b: arb(0.3) - (a - b)),
    "product": (2, lambda a, b: a * b, lambda a, b: a * b),
    "quotient": (2, lambda a, b: a / (b * b + 0.7), lambda a, b: a / (b * b + arb(0.7))),
    "power": (2, lambda a, b: a * (b * b + 0.6) ** 2.37, lambda a, b: a * (b * b + arb(0.6)) ** arb(2.37)),
    "angle": (2, lambda a, b: np.arctan2(a, b * b + 0.3), lambda a, b: (a / (b * b + arb(0.3))).atan()),
    "sine": (1, np.sin, lambda a: a.sin()),
    "cosine": (1, np.cos, lambda a: a.cos()),
    "exponential": (1, lambda a: np.exp(np.sin(a)), lambda a: a.sin().exp()),
    "root": (1, lambda a: np.sqrt(a * a + 1.5), lambda a: (a * a + arb(1.5)).sqrt()),
    "logarithm": (1, lambda a: np.log(a * a + 1.5), lambda a: (a * a + arb(1.5)).log()),
    "arc": (1, lambda a: np.arcsin(0.9 * np.sin(a)), lambda a: (arb(0.9) * a.sin()).asin()),
}


def expression(random, depth):
    if depth == 0:
        return int(random.integers(2))
    name = random.choice(list(OPERATIONS))
    return name, *(expression(random, depth - 1) for _ in range(OPERATIONS[name][0]))


def evaluate(tree, variables, kind):
    if isinstance(tree, int):
        return variables[tree]
    return OPERATIONS[tree[0]][kind](*(evaluate(branch, variables, kind) for branch in tree[1:]))


@pytest.mark.parametrize("seed", range(4))
def test_random_expressions(seed):
    """On domains from 1e-12 wide, where rounding is all there is, to 0.1."""
    random = np.random.default_rng(seed)
    enclosed = 0
    for _ in range(100):
        balls = ((2,), (1, 1))[int(random.integers(2))]
        space = ModelSpace(balls, int(random.integers(1, 5)))
        gradient = 10.0 ** random.uniform(-12.0, -1.0) * random.uniform(-1.0, 1.0, (2, 2))
        centre = random.uniform(-2.0, 2.0, 2)
        tree = expression(random, int(random.integers(1, 5)))
        try:
            found = evaluate(tree, [space.affine(c, g) for c, g in zip(centre, gradient, strict=True)], 1)
        except ValueError:
            continue  # a range that the bounds cannot keep within a function's domain is refused, which is sound
        z = random.standard_normal(2)
        z *= (1.0 - 1e-15) / (np.linalg.norm(z) if balls == (2,) else np.abs(z).max())
        with flint.ctx.workprec(300):
            at = [arb(value) for value in z.tolist()]
            variables = [
                arb(c) + arb(g[0]) * at[0] + arb(g[1]) * at[1]
                for c, g in zip(centre.tolist(), gradient.tolist(), strict=True)
            ]
            exact = evaluate(tree, variables, 2)
            terms = zip(found.coefficients.tolist(), space.taylor.exponents.tolist(), strict=True)
            polynomial = sum((arb(c) * at[0] ** i * at[1] ** j for c, (i, j) in terms), arb(0))
            assert abs(exact - polynomial) <= arb(float(found.remainder)), tree
        enclosed += 1
    assert enclosed > 80
