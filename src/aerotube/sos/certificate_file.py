"""Certificates as files: everything a separate check needs, with every number exact."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.sos.certificate import polynomial_of
from aerotube.sos.domain import Array
from aerotube.sos.residuals import matrix_value

if TYPE_CHECKING:
    from aerotube.sos.certificate import Certificate

FORMAT, VERSION = "aerotube sum-of-squares certificate", 1


def _exact(array: Any) -> Any:
    """Numbers as hexadecimal text, nested as the array is."""
    array = np.asarray(array, dtype=np.float64)
    if array.ndim == 0:
        return float(array).hex()
    return [_exact(part) for part in array]


def save(certificate: Certificate, path: str | Path, position: tuple[int, ...] = ()) -> None:
    """Write one program's certificate.

    Parameters
    ----------
    certificate : Certificate
    path : file to write, whole or not at all
    position : place in the batch
    """
    solution = certificate.solution
    data, structure = solution.data, solution.structure
    place = int(np.ravel_multi_index(position, data.batch)) if data.batch else 0
    _, arrays = data.one(place)
    d = solution.values[position]
    items = []
    for c in structure.constraints:
        a = arrays[c.name]
        item: dict[str, Any] = {"name": c.name, "kind": c.kind, "margin": _exact(certificate.margins[c.name][position])}
        if c.kind == "sos":
            item |= _sos_item(certificate, c.name, position, a["c"] + a["C"] @ d)
        elif c.kind in ("lmi", "logdet"):
            value = matrix_value(a, d)
            item["matrix"] = _exact(0.5 * (value + value.T))
        elif c.kind == "norm":
            item["vector"], item["bound"] = _exact(a["A"] @ d + a["b"]), _exact(a["g"] @ d + a["h"])
        else:
            item["slack"] = _exact(a["b"] - a["A"] @ d)
        items.append(item)
    content = {
        "format": FORMAT,
        "version": VERSION,
        "certificate": certificate.kind,
        "structure": structure.digest,
        "objective": _exact(solution.objective[position]),
        "variables": {v.name: _exact(v.unpack(d)) for v in structure.variables},
        "constraints": items,
    }
    path = Path(path)
    aside = path.with_name(path.name + ".part")
    aside.write_text(json.dumps(content), encoding="utf-8")
    os.replace(aside, path)


def _sos_item(certificate: Certificate, name: str, position: tuple[int, ...], values: Array) -> dict[str, Any]:
    found = certificate.solution.structure.sampling(name)
    blocks = []
    for block, gram in zip(found.blocks, certificate.grams[name], strict=True):
        weight = None
        if block.weight is not None:
            weight = {"exponents": block.weight.exponents.tolist(), "coefficients": _exact(block.weight.coefficients)}
        own = gram[position]
        blocks.append(
            {
                "boundary": list(block.boundary),
                "weight": weight,
                "exponents": block.basis.exponents.tolist(),
                "basis": _exact(block.basis.matrix),
                "gram": _exact(0.5 * (own + own.T)),
            }
        )
    return {
        "domain": [[factor.kind, factor.dimension] for factor in found.domain.factors],
        "degree": found.degree,
        "least": _exact(certificate.least[name][position]),
        "exponents": found.basis.exponents.tolist(),
        "polynomial": _exact(polynomial_of(found, values)),
        "blocks": blocks,
    }
