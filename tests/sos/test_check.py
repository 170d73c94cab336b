"""The check of saved certificates: exact about the program's own numbers, and about the whole program."""

import json
from fractions import Fraction
from math import prod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube import sos
from aerotube.sos import exact
from tests.sos import handmade
from tests.sos.programs import maximum_data, maximum_program, tube_data


def saved(solution, path):
    file = path / "certificate.json"
    solution.certificate().save(file)
    return file


def edited(file, change):
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))
    return file


def maximum(path, weights=()):
    structure = maximum_program(sos.Sphere(3), 4, weights)
    data = maximum_data(structure, lambda z: z[:, 0] + z[:, 1] * z[:, 2])
    return structure, saved(sos.solve(structure, data), path)


CANCELLING = [1e16, 1.0, -1e16]


def test_linear_rows_that_cancel_are_evaluated_exactly(tmp_path):
    report = sos.check_file(saved(handmade.linear([CANCELLING], [0.0], np.ones(3)), tmp_path))
    assert not report.holds
    assert report.findings[0].margin == -1.0


def test_matrices_that_cancel_are_evaluated_exactly(tmp_path):
    F = np.array([[[1e16]], [[-2.0]], [[-1e16]]])
    report = sos.check_file(saved(handmade.matrix([[1.0]], F, np.ones(3)), tmp_path))
    assert not report.holds
    assert report.findings[0].margin <= -1.0


def test_norms_that_cancel_are_evaluated_exactly(tmp_path):
    report = sos.check_file(saved(handmade.norm([CANCELLING], [0.0], np.zeros(3), 0.5, np.ones(3)), tmp_path))
    assert not report.holds
    assert report.findings[0].margin == -0.5


def test_polynomials_that_cancel_are_evaluated_exactly(tmp_path):
    domain = sos.Sphere(3)
    nodes = len(domain.exponents(4))
    C = np.tile([1e16, -1.0, -1e16], (nodes, 1))
    order = len(domain.exponents(2))
    solution = handmade.polynomial(domain, 4, np.zeros(nodes), [np.zeros((order, order))], C=C, d=np.ones(3))
    report = sos.check_file(saved(solution, tmp_path))
    assert not report.holds
    assert report.findings[0].margin <= -1.0


@pytest.mark.parametrize("kind", ["linear", "norm"])
def test_values_too_small_for_doubles_are_seen(tmp_path, kind):
    tiny = (
        handmade.linear([[1e-200]], [0.0], [1e-200])
        if kind == "linear"
        else handmade.norm([[1e-200]], [0.0], [0.0], 0.0, [1e-200])
    )
    report = sos.check_file(saved(tiny, tmp_path))
    assert not report.holds
    assert report.findings[0].margin < 0.0


def test_the_bound_of_a_norm_is_computed_whatever_is_claimed(tmp_path):
    file = saved(handmade.norm([[3e6], [4e6]], [0.0, 0.0], [0.0], 1.0, [1.0]), tmp_path)
    for claim in (5.0, -1.0, -1e9):
        edited(file, lambda content, claim=claim: content["constraints"][0].update(margin=claim.hex()))
        assert sos.check_file(file).findings[0].margin == 1.0 - 5e6


def test_a_file_without_constraints_claims_nothing(tmp_path):
    file = saved(handmade.linear([[1.0]], [2.0], [1.0]), tmp_path)
    assert sos.check_file(file).holds
    with pytest.raises(ValueError, match="claims nothing"):
        sos.check_file(edited(file, lambda content: content.update(constraints=[])))


def test_a_dropped_constraint_is_missed(tube, tmp_path):
    file = saved(sos.solve(tube, tube_data(tube, 0)), tmp_path)
    with pytest.raises(ValueError, match="dropped"):
        sos.check_file(edited(file, lambda content: content["constraints"].pop(3)))


def change_degree(item):
    item["degree"] = 2


def change_domain(item):
    item["domain"] = [["ball", 3]]


def change_weight(item):
    item["weights"][0]["coefficients"] = [(-1.0).hex()]


@pytest.mark.parametrize("change", [change_degree, change_domain, change_weight])
def test_another_domain_degree_or_weight_is_another_program(tmp_path, change):
    _, file = maximum(tmp_path, [sos.Polynomial([[1, 0, 0]], [1.0])])
    assert sos.check_file(file).holds
    with pytest.raises(ValueError, match="not those of the structure"):
        sos.check_file(edited(file, lambda content: change(content["constraints"][0])))


def test_the_program_that_is_expected_can_be_named(tmp_path):
    structure, file = maximum(tmp_path)
    assert sos.check_file(file, structure.digest).structure == structure.digest
    with pytest.raises(ValueError, match="not 0123456789abcdef"):
        sos.check_file(file, "0123456789abcdef")


def test_the_report_says_what_was_proven_where(tmp_path):
    structure, file = maximum(tmp_path, [sos.Polynomial([[1, 0, 0], [0, 0, 2]], [1.0, -0.25])])
    text = str(sos.check_file(file))
    assert "Sphere(3)" in text
    assert "degree 4" in text
    assert "+1 x1 -0.25 x3^2 >= 0" in text
    assert structure.digest in text


def remove_nodes(content):
    del content["constraints"][0]["nodes"]


def merge_nodes(content):
    nodes = content["constraints"][0]["nodes"]
    nodes[1] = nodes[0]


def negative_power(content):
    content["constraints"][0]["blocks"][0]["exponents"][0] = [-1, 0, 0]


def infinite_value(content):
    content["constraints"][0]["data"]["c"][0] = "inf"


def skewed_gram(content):
    gram = content["constraints"][0]["blocks"][0]["gram"]
    gram[0][1] = (float.fromhex(gram[0][1]) + 1.0).hex()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (remove_nodes, "damaged"),
        (merge_nodes, "do not determine"),
        (negative_power, "not those of a monomial"),
        (infinite_value, "not finite"),
        (skewed_gram, "not symmetric"),
    ],
)
def test_damage_is_named(tmp_path, change, sentence):
    _, file = maximum(tmp_path)
    with pytest.raises(ValueError, match=sentence):
        sos.check_file(edited(file, change))


def test_changed_values_are_found_out(tmp_path):
    _, file = maximum(tmp_path)

    def lower(content):
        c = content["constraints"][0]["data"]["c"]
        c[:] = [(float.fromhex(x) - 1e-3).hex() for x in c]

    before = sos.check_file(file)
    after = sos.check_file(edited(file, lower))
    assert before.holds
    assert not after.holds
    assert after.findings[0].margin == pytest.approx(before.findings[0].margin - 1e-3, abs=1e-9)
    file.write_text("{}")
    with pytest.raises(ValueError, match="not a certificate"):
        sos.check_file(file)


def test_the_objective_is_evaluated_from_the_file(tmp_path):
    program = sos.Program()
    program.symmetric("X", 2)
    program.logdet("volume", 2, 0.5)
    structure = program.compile()
    F = np.zeros((3, 2, 2))
    F[0, 0, 0] = F[1, 0, 1] = F[1, 1, 0] = F[2, 1, 1] = 1.0
    data = structure.data(objective=[1.0, 0.0, 1.0], constraints={"volume": (np.zeros((2, 2)), F)})
    report = sos.check_file(saved(handmade.handmade(structure, data, [2.0, 1.0, 3.0]), tmp_path))
    # X = [[2, 1], [1, 3]] has the trace 5, the determinant 5 and the least eigenvalue (5 - sqrt(5)) / 2.
    assert report.objective == pytest.approx(5.0 - 0.5 * np.log(5.0), rel=1e-15)
    assert report.findings[0].margin <= (5.0 - np.sqrt(5.0)) / 2.0


@settings(deadline=None, max_examples=30)
@given(
    st.lists(st.integers(-50, 50), min_size=9, max_size=9),
    st.sampled_from([[("sphere", 3)], [("ball", 2)], [("sphere", 2), ("ball", 1)]]),
)
def test_interpolation_bounds_its_own_error(numbers, domain):
    exponents = exact.monomials_on(domain, 2)
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (len(exponents), sum(d for _, d in domain)))
    nodes = [[Fraction(float(x)) for x in point] for point in points]
    coefficients = dict(zip(exponents, (Fraction(x, 7) for x in numbers), strict=False))
    values = [sum(c * prod(x**k for x, k in zip(z, e, strict=True)) for e, c in coefficients.items()) for z in nodes]
    found, error = exact.interpolated(nodes, [Fraction(x) for x in values], exponents)
    assert sum(abs(found[e] - coefficients.get(e, Fraction(0))) for e in exponents) <= error
    assert error <= Fraction(1, 10**30)


@settings(deadline=None, max_examples=100)
@given(st.fractions(min_value=0, max_value=10**6))
def test_roots_are_bounded_from_above(square):
    root = exact.root_above(square)
    assert root**2 >= square
    assert (root * (1 - Fraction(1, 2**60))) ** 2 <= square
    assert exact.root_above(square**2) == square
