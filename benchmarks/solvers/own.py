"""The project's own solver."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from aerotube import sos
from benchmarks.neutral import Lmi, Norm, Program, Sos

Prepared = tuple[sos.Structure, sos.Data]


def _shape(program: Program) -> tuple[Any, ...]:
    out: list[Any] = [program.size]
    for c in program.constraints:
        if isinstance(c, Sos):
            out.append(("sos", c.name, c.factors, c.degree))
        elif isinstance(c, Lmi):
            out.append(("lmi", c.name, len(c.F0)))
        else:
            out.append(("norm" if isinstance(c, Norm) else "linear", c.name, len(c.b)))
    return tuple(out)


@lru_cache(maxsize=16)
def _structure(shape: tuple[Any, ...]) -> sos.Structure:
    program = sos.Program()
    program.matrix("d", (shape[0],))
    for kind, name, *rest in shape[1:]:
        if kind == "sos":
            factors = {"sphere": sos.Sphere, "ball": sos.Ball}
            program.sos(name, sos.Product(*(factors[k](n) for k, n in rest[0])), degree=rest[1])
        else:
            getattr(program, kind)(name, rest[0])
    return program.compile()


def _arrays(structure: sos.Structure, c: Any) -> tuple[Any, ...]:
    if isinstance(c, Sos):
        values = structure.values(c.name, c.exponents, np.vstack([c.c, c.C.T]))
        return values[0], values[1:].T
    if isinstance(c, Lmi):
        return c.F0, c.F
    return (c.A, c.b, c.g, np.asarray(c.h)) if isinstance(c, Norm) else (c.A, c.b)


def prepare(program: Program) -> Prepared:
    """Compile the structure (once for each shape) and make the data."""
    structure = _structure(_shape(program))
    arrays = {c.name: _arrays(structure, c) for c in program.constraints}
    return structure, structure.data(objective=program.objective, constraints=arrays)


def prepare_batch(programs: Sequence[Program]) -> Prepared:
    """Make the data of many programs of one shape."""
    structure = _structure(_shape(programs[0]))
    arrays = {}
    for i, c in enumerate(programs[0].constraints):
        each = [_arrays(structure, program.constraints[i]) for program in programs]
        arrays[c.name] = tuple(np.stack(parts) for parts in zip(*each, strict=True))
    return structure, structure.data(objective=np.stack([p.objective for p in programs]), constraints=arrays)


def solve(prepared: Prepared, **options: Any) -> dict[str, Any]:
    """Solve, with default settings unless options are given; seconds, objective, certified bound and status."""
    start = time.perf_counter()
    solution = sos.solve(*prepared, **options)
    seconds = time.perf_counter() - start
    bound = float(solution.certificate().bound)
    return {
        "seconds": seconds,
        "objective": float(solution.objective),
        "certified": bound if np.isfinite(bound) else None,
        "status": str(sos.Status(int(solution.status))),
        "iterations": int(solution.iterations),
    }
