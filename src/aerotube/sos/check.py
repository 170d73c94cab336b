"""Checking a saved certificate in exact arithmetic, by code that shares nothing with the solver.

All numbers of the file are binary fractions, so everything here is done in whole numbers: the squares are multiplied
out, reduced on the spheres by x_n^2 = 1 - x_1^2 - ..., compared with the polynomial coefficient by coefficient, and the
Gram matrices are shown to be positive definite by fraction-free elimination. What remains is bounded by the sum of its
coefficients' magnitudes, since every monomial is at most one on the unit sphere, ball and interval.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fractions import Fraction
from math import inf, nextafter
from operator import mul
from pathlib import Path
from typing import Any

Terms = dict[tuple[int, ...], Fraction]
FORMAT = "aerotube sum-of-squares certificate"


@dataclass(frozen=True)
class Finding:
    """What the check found for one constraint.

    Attributes
    ----------
    name, kind : str
    margin : float
        Proven lower bound of the constraint's value, rounded down.
    holds : bool
        Whether the proven bound is not negative.
    """

    name: str
    kind: str
    margin: float
    holds: bool


@dataclass(frozen=True)
class Report:
    """Findings for every constraint of a certificate.

    Attributes
    ----------
    findings : tuple of Finding
    objective : float
    """

    findings: tuple[Finding, ...]
    objective: float

    @property
    def holds(self) -> bool:
        """Whether every constraint is proven."""
        return all(finding.holds for finding in self.findings)

    def __str__(self) -> str:
        lines = [
            f"{f.name}: {'holds' if f.holds else 'NOT PROVEN'}, value at least {f.margin:.6g} ({f.kind})"
            for f in self.findings
        ]
        verdict = "The certificate holds." if self.holds else "The certificate does not hold as it stands."
        return "\n".join([*lines, f"objective {self.objective:.12g}", verdict])


def check_file(path: str | Path) -> Report:
    """Check a file written by `aerotube.sos.Certificate.save`.

    Raises
    ------
    ValueError
        If the file is not a certificate, or is damaged; the sentence says where.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise ValueError(f"{path} is not a certificate: it is not valid JSON.") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"{path} is not a certificate of this project; its format is not '{FORMAT}'.")
    if content.get("version") != 1:
        raise ValueError(f"{path} has the version {content.get('version')}, and only 1 can be checked.")
    try:
        findings = tuple(_check(item) for item in content["constraints"])
        objective = float.fromhex(content["objective"])
    except (KeyError, TypeError, IndexError, OverflowError) as error:
        raise ValueError(f"{path} is damaged: {type(error).__name__} at {error}.") from error
    return Report(findings, objective)


def _number(text: str) -> Fraction:
    return Fraction(float.fromhex(text))


def _rounded_down(value: Fraction) -> float:
    nearest = float(value)
    if Fraction(nearest) <= value:
        return nearest
    return nextafter(nearest, -inf)


def _check(item: dict[str, Any]) -> Finding:
    kind = item["kind"]
    if kind == "sos":
        margin = _sos_margin(item)
    elif kind in ("lmi", "logdet"):
        matrix = [[_number(x) for x in row] for row in item["matrix"]]
        margin = _proven_least(matrix, _number(item["margin"]))
    elif kind == "norm":
        bound, square = _number(item["bound"]), sum((_number(x) ** 2 for x in item["vector"]), Fraction(0))
        claim = _number(item["margin"])
        # The claim is proven if the norm is at most bound - claim; otherwise fall back on whether the bound holds.
        margin = claim if bound >= claim and square <= (bound - claim) ** 2 else Fraction(-1)
        if margin < 0 <= bound and square <= bound**2:
            margin = Fraction(0)
    elif kind == "linear":
        margin = min(_number(x) for x in item["slack"])
    else:
        raise ValueError(f"the constraint '{item['name']}' is of the unknown kind '{kind}'.")
    return Finding(item["name"], kind, _rounded_down(margin), margin >= 0)


def _proven_least(matrix: list[list[Fraction]], claim: Fraction) -> Fraction:
    """Return a proven lower bound of the least eigenvalue: the claim, or the claim lowered until it can be proven."""
    size = max((abs(x) for row in matrix for x in row), default=Fraction(0))
    step = max(size, Fraction(1, 2**200)) / 2**50
    for _ in range(60):
        if _positive_definite(matrix, claim):
            return claim
        claim -= step
        step *= 2
    return -len(matrix) * size


def _positive_definite(matrix: list[list[Fraction]], shift: Fraction) -> bool:
    """Whether matrix - shift I is positive definite: fraction-free (Bareiss) elimination of whole numbers."""
    n = len(matrix)
    common = max([x.denominator for row in matrix for x in row] + [shift.denominator])
    a = [[int(x * common) for x in row] for row in matrix]
    for i in range(n):
        a[i][i] -= int(shift * common)
        for j in range(i):
            if a[i][j] != a[j][i]:
                raise ValueError("a matrix of the certificate is not symmetric.")
    before = 1
    for k in range(n):
        pivot = a[k][k]
        if pivot <= 0:
            return False
        for i in range(k + 1, n):
            for j in range(k + 1, i + 1):
                a[i][j] = a[j][i] = (a[i][j] * pivot - a[i][k] * a[k][j]) // before
        before = pivot
    return True


def _sos_margin(item: dict[str, Any]) -> Fraction:
    """Proven lower bound of a polynomial on its domain."""
    domain = [(str(kind), int(dimension)) for kind, dimension in item["domain"]]
    claimed = _number(item["least"])
    remainder: Terms = {}
    for exponents, value in zip(item["exponents"], item["polynomial"], strict=True):
        _add(remainder, tuple(exponents), _number(value))
    squares: Terms = {}
    least: Fraction | None = None
    extra = Fraction(0)
    for block in item["blocks"]:
        gram = [[_number(x) for x in row] for row in block["gram"]]
        basis = [[_number(x) for x in row] for row in block["basis"]]
        exponents = [tuple(e) for e in block["exponents"]]
        weight = _weight(block, domain)
        own = _proven_least(gram, claimed)
        for key, value in _times(_form(_congruence(basis, gram), exponents), weight).items():
            _add(remainder, key, -value)
        lengths = _times(_form(_congruence(basis, None), exponents), weight)
        if block["weight"] is None:
            least = own if least is None else min(least, own)
            for key, value in lengths.items():
                _add(squares, key, value)
        else:
            extra += min(Fraction(0), own) * sum((abs(x) for x in lengths.values()), Fraction(0))
    remainder, squares = _reduce(remainder, domain), _reduce(squares, domain)
    constant = squares.pop((0,) * sum(d for _, d in domain), Fraction(0))
    wobble = sum((abs(x) for x in squares.values()), Fraction(0))
    least = Fraction(0) if least is None else least
    floor = least * (constant - wobble if least > 0 else constant + wobble)
    return floor + extra - sum((abs(x) for x in remainder.values()), Fraction(0))


def _congruence(basis: list[list[Fraction]], gram: list[list[Fraction]] | None) -> list[list[Fraction]]:
    """B' Q B in whole numbers over one denominator (Q = I if None)."""
    n = len(basis)
    b_scale = max(x.denominator for row in basis for x in row)
    b = [[int(x * b_scale) for x in row] for row in basis]
    if gram is None:
        q_scale, middle = 1, b
    else:
        q_scale = max(x.denominator for row in gram for x in row)
        q = [[int(x * q_scale) for x in row] for row in gram]
        columns = list(zip(*b, strict=True))
        middle = [[sum(map(mul, row, column)) for column in columns] for row in q]
    left, right = list(zip(*b, strict=True)), list(zip(*middle, strict=True))
    scale = b_scale * b_scale * q_scale
    return [
        [Fraction(sum(x * y for x, y in zip(left[i], right[j], strict=True)), scale) for j in range(n)]
        for i in range(n)
    ]


def _form(matrix: list[list[Fraction]], exponents: list[tuple[int, ...]]) -> Terms:
    """The polynomial m' R m in the monomials m."""
    terms: Terms = {}
    for i, first in enumerate(exponents):
        for j, second in enumerate(exponents):
            _add(terms, tuple(a + b for a, b in zip(first, second, strict=True)), matrix[i][j])
    return terms


def _weight(block: dict[str, Any], domain: list[tuple[str, int]]) -> Terms:
    total = sum(d for _, d in domain)
    result: Terms = {(0,) * total: Fraction(1)}
    for place in block["boundary"]:
        start = sum(d for _, d in domain[:place])
        factor: Terms = {(0,) * total: Fraction(1)}
        for k in range(start, start + domain[place][1]):
            factor[tuple(2 if i == k else 0 for i in range(total))] = Fraction(-1)
        result = _times(result, factor)
    if block["weight"] is not None:
        own: Terms = {}
        for exponents, value in zip(block["weight"]["exponents"], block["weight"]["coefficients"], strict=True):
            _add(own, tuple(exponents), _number(value))
        result = _times(result, own)
    return result


def _add(terms: Terms, key: tuple[int, ...], value: Fraction) -> None:
    terms[key] = terms.get(key, Fraction(0)) + value


def _times(a: Terms, b: Terms) -> Terms:
    if len(b) == 1 and all(k == 0 for k in next(iter(b))):
        factor = next(iter(b.values()))
        return {key: value * factor for key, value in a.items()}
    result: Terms = {}
    for first, x in a.items():
        for second, y in b.items():
            _add(result, tuple(i + j for i, j in zip(first, second, strict=True)), x * y)
    return result


def _reduce(terms: Terms, domain: list[tuple[str, int]]) -> Terms:
    """Rewrite with the last coordinate of every sphere at most to the first power."""
    spheres, at = [], 0
    for kind, dimension in domain:
        if kind == "sphere":
            spheres.append((at, at + dimension - 1))
        at += dimension
    pending = dict(terms)
    result: Terms = {}
    while pending:
        key, value = pending.popitem()
        for start, last in spheres:
            if key[last] >= 2:
                lower = tuple(k - 2 if i == last else k for i, k in enumerate(key))
                _add(pending, lower, value)
                for j in range(start, last):
                    _add(pending, tuple(k + 2 if i == j else k for i, k in enumerate(lower)), -value)
                break
        else:
            _add(result, key, value)
    return result
