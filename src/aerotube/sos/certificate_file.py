"""Certificates as files: the program's own numbers and the Gram matrices, every number exact."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from aerotube.sos.certificate import Certificate
    from aerotube.sos.program import Constraint

FORMAT, VERSION = "aerotube sum-of-squares certificate", 2


def _exact(array: Any) -> Any:
    """Numbers as hexadecimal text, nested as the array is."""
    array = np.asarray(array, dtype=np.float64)
    if array.ndim == 0:
        return float(array).hex()
    return [_exact(part) for part in array]


def save(certificate: Certificate, path: str | Path, position: tuple[int, ...] = ()) -> None:
    """Write one program's certificate.

    Nothing is evaluated here: the file holds the decision and the data as they are, so that what is checked is the
    program itself and not a rounding of it.

    Parameters
    ----------
    certificate : Certificate
    path : file to write, whole or not at all
    position : place in the batch
    """
    solution = certificate.solution
    data, structure = solution.data, solution.structure
    place = int(np.ravel_multi_index(position, data.batch)) if data.batch else 0
    objective, arrays = data.one(place)
    items = []
    for c in structure.constraints:
        item: dict[str, Any] = {
            "name": c.name,
            "kind": c.kind,
            "size": c.size,
            "margin": _exact(certificate.margins[c.name][position]),
            "data": {key: _exact(array) for key, array in arrays[c.name].items()},
        }
        if c.kind == "sos":
            item |= _sos_item(certificate, c, position)
        elif c.kind == "logdet":
            item["factor"] = _exact(c.factor)
        items.append(item)
    content = {
        "format": FORMAT,
        "version": VERSION,
        "certificate": certificate.kind,
        "structure": structure.digest,
        "variables": [[v.name, v.kind, list(v.shape)] for v in structure.variables],
        "decision": _exact(solution.values[position]),
        "objective": _exact(objective),
        "constraints": items,
    }
    path = Path(path)
    aside = path.with_name(path.name + ".part")
    aside.write_text(json.dumps(content), encoding="utf-8")
    os.replace(aside, path)


def _sos_item(certificate: Certificate, c: Constraint, position: tuple[int, ...]) -> dict[str, Any]:
    found = certificate.solution.structure.sampling(c.name)
    blocks = []
    for block, gram in zip(found.blocks, certificate.grams[c.name], strict=True):
        own = gram[position]
        blocks.append(
            {
                "boundary": list(block.boundary),
                "weight": None if block.weight is None else c.weights.index(block.weight),
                "exponents": block.basis.exponents.tolist(),
                "basis": _exact(block.basis.matrix),
                "gram": _exact(0.5 * (own + own.T)),
            }
        )
    return {
        "domain": [[factor.kind, factor.dimension] for factor in found.domain.factors],
        "degree": found.degree,
        "weights": [{"exponents": w.exponents.tolist(), "coefficients": _exact(w.coefficients)} for w in c.weights],
        "nodes": _exact(found.nodes),
        "least": _exact(certificate.least[c.name][position]),
        "blocks": blocks,
    }
