"""Checking a saved certificate in exact arithmetic, by code that shares nothing with the solver.

All numbers of the file are binary fractions, so everything here is done in whole numbers: the constraints are evaluated
at the decision, the polynomials through the values at the nodes are found, the squares are multiplied out, reduced on
the spheres and compared with them coefficient by coefficient, and the Gram matrices are shown to be positive definite
(`aerotube.sos.exact`). What remains is bounded by the sum of its coefficients' magnitudes, since every monomial is at
most one on the unit sphere, ball and interval.

The names, sizes, domains, degrees and weights that are checked are those of the program: their digest is formed again
and compared with the file's.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from fractions import Fraction
from math import inf, isfinite, log, nextafter, prod
from operator import mul
from pathlib import Path
from typing import Any

from aerotube.sos import exact
from aerotube.sos.exact import Factors, Matrix, Terms

FORMAT, VERSION = "aerotube sum-of-squares certificate", 2


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
    about : str
        What the value is: for a polynomial its degree, its domain and the weights that cut it.
    """

    name: str
    kind: str
    margin: float
    holds: bool
    about: str


@dataclass(frozen=True)
class Report:
    """Findings for every constraint of a certificate.

    Attributes
    ----------
    findings : tuple of Finding
    objective : float
        Objective at the decision, evaluated from the file's numbers.
    structure : str
        Digest of the program's structure, as `aerotube.sos.Structure.digest`.
    """

    findings: tuple[Finding, ...]
    objective: float
    structure: str

    @property
    def holds(self) -> bool:
        """Whether every constraint is proven."""
        return bool(self.findings) and all(finding.holds for finding in self.findings)

    def __str__(self) -> str:
        lines = [
            f"{f.name}: {'holds' if f.holds else 'NOT PROVEN'}, value at least {f.margin:.6g} ({f.about})"
            for f in self.findings
        ]
        verdict = "The certificate holds." if self.holds else "The certificate does not hold as it stands."
        return "\n".join([*lines, f"objective {self.objective:.12g}, structure {self.structure}", verdict])


def check_file(path: str | Path, structure: str | None = None) -> Report:
    """Check a file written by `aerotube.sos.Certificate.save`.

    Parameters
    ----------
    path : file
    structure : str, optional
        Digest that the program must have (`aerotube.sos.Structure.digest`); without it, the report names the file's.

    Raises
    ------
    ValueError
        If the file is not a certificate, is damaged, lacks constraints, or is of another program; the sentence says
        where.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise ValueError(f"{path} is not a certificate: it is not valid JSON.") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"{path} is not a certificate of this project; its format is not '{FORMAT}'.")
    if content.get("version") != VERSION:
        raise ValueError(f"{path} has the version {content.get('version')}, and only {VERSION} can be checked.")
    try:
        if not content["constraints"]:
            raise ValueError("it has no constraints and claims nothing.")
        digest = _digest(content)
        if digest != content["structure"]:
            raise ValueError(
                f"its constraints and variables are not those of the structure {content['structure']} it names: "
                "something was dropped, added or changed."
            )
        if structure is not None and digest != structure:
            raise ValueError(f"it is of the program with the structure {digest}, not {structure}.")
        decision = _numbers(content["decision"])
        if len(decision) != sum(_variable_size(v) for v in content["variables"]):
            raise ValueError("its decision has another length than its variables.")
        findings = tuple(_check(item, decision) for item in content["constraints"])
        objective = _objective(content, decision)
    except (KeyError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise ValueError(f"{path} is damaged: {type(error).__name__} at {error}.") from error
    except ValueError as error:
        raise ValueError(f"{path} cannot be checked: {error}") from error
    return Report(findings, objective, digest)


def _digest(content: dict[str, Any]) -> str:
    """Digest of the structure that the file's constraints have, by the rule of `aerotube.sos.Structure.digest`."""
    text = repr([(str(name), str(kind), tuple(shape)) for name, kind, shape in content["variables"]])
    for item in content["constraints"]:
        domain, degree, weights = "None", 0, []
        if item["kind"] == "sos":
            domain, degree = _domain_text(item), item["degree"]
            weights = [(w["exponents"], [float.fromhex(x) for x in w["coefficients"]]) for w in item["weights"]]
        factor = float.fromhex(item["factor"]) if item["kind"] == "logdet" else 0.0
        text += repr((item["name"], item["kind"], item["size"], domain, degree, weights, factor))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _variable_size(variable: list[Any]) -> int:
    _, kind, shape = variable
    return shape[0] * (shape[0] + 1) // 2 if kind == "symmetric" else prod(shape)


def _number(text: str) -> Fraction:
    value = float.fromhex(text)
    if not isfinite(value):
        raise ValueError("it holds a number that is not finite.")
    return Fraction(value)


def _numbers(texts: list[str]) -> list[Fraction]:
    return [_number(text) for text in texts]


def _claim(text: str) -> Fraction:
    """Return a claimed bound to start from; 0 if nothing finite is claimed."""
    value = float.fromhex(text)
    return Fraction(value) if isfinite(value) else Fraction(0)


def _rounded_down(value: Fraction) -> float:
    try:
        nearest = float(value)
    except OverflowError:
        return nextafter(inf, 0.0) if value > 0 else -inf
    if Fraction(nearest) <= value:
        return nearest
    return nextafter(nearest, -inf)


def _affine(rows: list[list[str]], offset: list[str], decision: list[Fraction], count: int) -> list[Fraction]:
    """Values of A d + b, after a check of the shapes."""
    if len(rows) != count or len(offset) != count or any(len(row) != len(decision) for row in rows):
        raise ValueError("the data of a constraint have another shape than its size asks for.")
    used = [(j, x) for j, x in enumerate(decision) if x]
    return [
        _number(b) + sum((_number(row[j]) * x for j, x in used if row[j] != "0x0.0p+0"), Fraction(0))
        for row, b in zip(rows, offset, strict=True)
    ]


def _matrix(item: dict[str, Any], decision: list[Fraction]) -> Matrix:
    """F0 + sum_i d_i F_i, its symmetric part."""
    n, data = item["size"], item["data"]
    if len(data["F"]) != len(decision) or any(len(part) != n for part in [data["F0"], *data["F"]]):
        raise ValueError(f"the data of '{item['name']}' have another shape than its size asks for.")
    value = [
        _affine([[part[i][j] for part in data["F"]] for j in range(n)], data["F0"][i], decision, n) for i in range(n)
    ]
    return [[(value[i][j] + value[j][i]) / 2 for j in range(n)] for i in range(n)]


def _check(item: dict[str, Any], decision: list[Fraction]) -> Finding:
    kind, count, data = item["kind"], item["size"], item["data"]
    if kind == "sos":
        margin = _sos_margin(item, _affine(data["C"], data["c"], decision, count))
        about = _about(item)
    elif kind in ("lmi", "logdet"):
        margin = _proven_least(_matrix(item, decision), _claim(item["margin"]))
        about = f"least eigenvalue of a matrix of order {count}"
    elif kind == "norm":
        (bound,) = _affine([data["g"]], [data["h"]], decision, 1)
        vector = _affine(data["A"], data["b"], decision, count)
        margin = bound - exact.root_above(sum((x * x for x in vector), Fraction(0)))
        about = f"bound less the norm of a vector of {count}"
    elif kind == "linear":
        value = _affine(data["A"], ["0x0.0p+0"] * count, decision, count)
        margin = min(b - x for b, x in zip(_numbers(data["b"]), value, strict=True))
        about = f"least slack of {count} row{'s' * (count != 1)}"
    else:
        raise ValueError(f"the constraint '{item['name']}' is of the unknown kind '{kind}'.")
    return Finding(item["name"], kind, _rounded_down(margin), margin >= 0, about)


def _objective(content: dict[str, Any], decision: list[Fraction]) -> float:
    total = float(sum(map(mul, _numbers(content["objective"]), decision), Fraction(0)))
    for item in content["constraints"]:
        if item["kind"] == "logdet":
            volume = exact.determinant(_matrix(item, decision))
            if not volume:
                return inf
            # Of whole numbers, so that no size of determinant over- or underflows.
            total -= float.fromhex(item["factor"]) * (log(volume.numerator) - log(volume.denominator))
    return total


def _proven_least(matrix: Matrix, claim: Fraction) -> Fraction:
    """Return a proven lower bound of the least eigenvalue: the claim, or the claim lowered until it can be proven."""
    size = max((abs(x) for row in matrix for x in row), default=Fraction(0))
    step = max(size, Fraction(1, 2**200)) / 2**50
    for _ in range(60):
        if exact.positive_definite(matrix, claim):
            return claim
        claim -= step
        step *= 2
    return -len(matrix) * size


def _sos_margin(item: dict[str, Any], values: list[Fraction]) -> Fraction:
    """Proven lower bound on its domain, where its weights are not negative, of the polynomial through the values."""
    domain = _domain(item)
    own_weights = [_weight_terms(weight, domain) for weight in item["weights"]]
    monomials = exact.monomials_on(domain, item["degree"])
    nodes = [_numbers(node) for node in item["nodes"]]
    if len(nodes) != len(monomials) or len(values) != len(nodes):
        raise ValueError(f"'{item['name']}' has {len(nodes)} nodes, and {len(monomials)} determine its polynomial.")
    remainder, error = exact.interpolated(nodes, values, monomials)
    claimed = _claim(item["least"])
    squares: Terms = {}
    least: Fraction | None = None
    extra = Fraction(0)
    for block in item["blocks"]:
        gram, basis = [_numbers(row) for row in block["gram"]], [_numbers(row) for row in block["basis"]]
        exponents = [_exponents(e, domain) for e in block["exponents"]]
        weight = _boundary(block["boundary"], domain)
        if block["weight"] is not None:
            weight = exact.times(weight, own_weights[block["weight"]])
        own = _proven_least(gram, claimed)
        for key, value in exact.times(exact.form(exact.congruence(basis, gram), exponents), weight).items():
            exact.add(remainder, key, -value)
        lengths = exact.times(exact.form(exact.congruence(basis, None), exponents), weight)
        if block["weight"] is None:
            least = own if least is None else min(least, own)
            for key, value in lengths.items():
                exact.add(squares, key, value)
        else:
            extra += min(Fraction(0), own) * exact.size(exact.reduced(lengths, domain))
    remainder, squares = exact.reduced(remainder, domain), exact.reduced(squares, domain)
    constant = squares.pop((0,) * sum(d for _, d in domain), Fraction(0))
    wobble = exact.size(squares)
    least = Fraction(0) if least is None else least
    floor = least * (constant - wobble if least > 0 else constant + wobble)
    return floor + extra - exact.size(remainder) - error


def _domain(item: dict[str, Any]) -> Factors:
    factors = [(str(kind), int(dimension)) for kind, dimension in item["domain"]]
    for kind, dimension in factors:
        if kind not in ("sphere", "ball") or dimension < 1:
            raise ValueError(f"the domain of '{item['name']}' has the unknown factor {kind}({dimension}).")
    return factors


def _domain_text(item: dict[str, Any]) -> str:
    return " x ".join(f"{kind.capitalize()}({dimension})" for kind, dimension in _domain(item))


def _exponents(powers: list[int], domain: Factors) -> tuple[int, ...]:
    if len(powers) != sum(d for _, d in domain) or any(not isinstance(k, int) or k < 0 for k in powers):
        raise ValueError(f"the exponents {powers} are not those of a monomial on its domain.")
    return tuple(powers)


def _weight_terms(weight: dict[str, Any], domain: Factors) -> Terms:
    terms: Terms = {}
    for powers, value in zip(weight["exponents"], weight["coefficients"], strict=True):
        exact.add(terms, _exponents(powers, domain), _number(value))
    return terms


def _boundary(places: list[int], domain: Factors) -> Terms:
    """Product of the polynomials 1 - |x|^2 of different factors of the domain: not negative there."""
    total = sum(d for _, d in domain)
    result: Terms = {(0,) * total: Fraction(1)}
    if len(set(places)) != len(places) or not set(places) <= set(range(len(domain))):
        raise ValueError(f"there are no balls at the places {places} of a domain.")
    for place in places:
        start = sum(d for _, d in domain[:place])
        factor: Terms = {(0,) * total: Fraction(1)}
        for k in range(start, start + domain[place][1]):
            factor[tuple(2 if i == k else 0 for i in range(total))] = Fraction(-1)
        result = exact.times(result, factor)
    return result


def _about(item: dict[str, Any]) -> str:
    """What a polynomial's value is, with the weights in the coordinates x1, x2, ... of the whole domain."""
    words = f"least value on {_domain_text(item)} of a polynomial of degree {item['degree']}"
    weights = []
    for weight in item["weights"]:
        parts = []
        for powers, value in zip(weight["exponents"], weight["coefficients"], strict=True):
            factors = [f"x{i + 1}" + (f"^{k}" if k > 1 else "") for i, k in enumerate(powers) if k]
            parts.append(" ".join([f"{float.fromhex(value):+.6g}", *factors]))
        weights.append(" ".join(parts) + " >= 0")
    return words + (f", where {' and '.join(weights)}" if weights else "")
