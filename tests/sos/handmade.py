"""Solutions put together by hand: decisions, Gram matrices and multipliers that no solver need have found."""

import numpy as np

from aerotube import sos


def handmade(structure, data, values, grams=None, multipliers=None, status=sos.Status.OPTIMAL):
    batch = data.batch
    values = np.broadcast_to(np.asarray(values, dtype=float), (*batch, structure.size))
    zero = np.zeros(batch)
    return sos.Solution(
        structure=structure,
        data=data,
        values=values,
        objective=np.sum(data.objective * values, axis=-1),
        status=np.full(batch, int(status)),
        iterations=np.zeros(batch, dtype=np.int64),
        seconds=zero,
        grams=grams or {},
        multipliers=multipliers or {},
        primal_residual=zero,
        dual_residual=zero,
        gap=zero,
        backend="handmade",
    )


def linear(A, b, d):
    program = sos.Program()
    program.matrix("x", (len(d),))
    program.linear("rows", len(b))
    structure = program.compile()
    return handmade(structure, structure.data(objective=np.zeros(len(d)), constraints={"rows": (A, b)}), d)


def norm(A, b, g, h, d):
    program = sos.Program()
    program.matrix("x", (len(d),))
    program.norm("length", len(b))
    structure = program.compile()
    return handmade(structure, structure.data(objective=np.zeros(len(d)), constraints={"length": (A, b, g, h)}), d)


def matrix(F0, F, d):
    program = sos.Program()
    program.matrix("x", (len(d),))
    program.lmi("matrix", len(F0))
    structure = program.compile()
    return handmade(structure, structure.data(objective=np.zeros(len(d)), constraints={"matrix": (F0, F)}), d)


def polynomial(domain, degree, values, grams, weights=(), C=None, d=(0.0,)):
    """One sum-of-squares constraint with c = values and given Gram matrices."""
    program = sos.Program()
    program.matrix("x", (len(d),))
    program.sos("f", domain, degree, weights)
    structure = program.compile()
    C = np.zeros((len(values), len(d))) if C is None else C
    data = structure.data(objective=np.zeros(len(d)), constraints={"f": (values, C)})
    return handmade(structure, data, d, {"f": tuple(grams)})
