"""The description of a parametric sum-of-squares program, and its frozen structure."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotube.sos.basis import Polynomial, Sampling, monomials, sampling
from aerotube.sos.domain import Array, Domain

KINDS = ("sos", "lmi", "logdet", "norm", "linear")


@dataclass(frozen=True)
class Variable:
    """A named part of the decision vector d.

    Attributes
    ----------
    name : str
    kind : str
        ``"scalar"``, ``"matrix"`` or ``"symmetric"``.
    shape : tuple of int
        Shape of the unpacked variable.
    start, stop : int
        Its slice of d. A symmetric matrix is packed as its lower triangle, row by row; a matrix row by row.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    start: int
    stop: int

    @property
    def slice(self) -> slice:
        """Slice of the decision vector."""
        return slice(self.start, self.stop)

    @property
    def size(self) -> int:
        """Number of entries of d."""
        return self.stop - self.start

    @property
    def index(self) -> NDArray[np.int64]:
        """Positions in d of the entries, in the variable's shape."""
        if self.kind != "symmetric":
            return np.arange(self.start, self.stop).reshape(self.shape)
        n = self.shape[0]
        i, j = np.maximum(*np.indices((n, n))), np.minimum(*np.indices((n, n)))
        return np.asarray(self.start + i * (i + 1) // 2 + j)

    def __getitem__(self, key: Any) -> Any:
        """Positions in d of an entry ``N[i, j]``, or of a row ``N[i]``."""
        found = self.index[key]
        return int(found) if np.ndim(found) == 0 else found

    def unpack(self, values: ArrayLike) -> Array:
        """Take the variable (..., *shape) out of decision vectors (..., m)."""
        return np.asarray(values, dtype=np.float64)[..., self.index]

    def pack(self, value: ArrayLike) -> Array:
        """Give the entries (..., size) that stand in d for a variable (..., *shape)."""
        value = np.asarray(value, dtype=np.float64)
        if self.kind == "symmetric":
            rows, columns = np.tril_indices(self.shape[0])
            return value[..., rows, columns]
        return value.reshape(*value.shape[: value.ndim - len(self.shape)], self.size)


@dataclass(frozen=True)
class Constraint:
    """One named constraint of a structure.

    Attributes
    ----------
    name : str
    kind : str
        ``"sos"``, ``"lmi"``, ``"logdet"``, ``"norm"`` or ``"linear"``.
    size : int
        Nodes U, order of the matrix, length of the vector, or number of rows.
    domain, degree, weights
        Of a sum-of-squares constraint.
    factor : float
        Weight of a log-determinant term in the objective.
    """

    name: str
    kind: str
    size: int
    domain: Domain | None = None
    degree: int = 0
    weights: tuple[Polynomial, ...] = ()
    factor: float = 0.0

    def shapes(self, m: int) -> dict[str, tuple[int, ...]]:
        """Names and trailing shapes of the arrays that hold the constraint's data."""
        k = self.size
        if self.kind == "sos":
            return {"c": (k,), "C": (k, m)}
        if self.kind in ("lmi", "logdet"):
            return {"F0": (k, k), "F": (m, k, k)}
        if self.kind == "norm":
            return {"A": (k, m), "b": (k,), "g": (m,), "h": ()}
        return {"A": (k, m), "b": (k,)}


@dataclass(frozen=True, eq=False)
class Structure:
    """A compiled program: everything but the numbers. Two structures of the same content are equal.

    Attributes
    ----------
    variables : tuple of Variable
    constraints : tuple of Constraint
    size : int
        m, the number of decision variables.
    """

    variables: tuple[Variable, ...]
    constraints: tuple[Constraint, ...]
    size: int
    _samplings: Mapping[str, Sampling] = field(repr=False)

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, Structure) and hash(self) == hash(other) and self._key() == other._key()

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        return self.variables, self.constraints

    @property
    def digest(self) -> str:
        """A short text that names the structure's content, the same on every machine."""
        text = repr([(v.name, v.kind, v.shape) for v in self.variables])
        for c in self.constraints:
            weights = [(w.exponents.tolist(), w.coefficients.tolist()) for w in c.weights]
            text += repr((c.name, c.kind, c.size, str(c.domain), c.degree, weights, c.factor))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def variable(self, name: str) -> Variable:
        """Return the variable of that name; KeyError if there is none."""
        for variable in self.variables:
            if variable.name == name:
                return variable
        raise KeyError(f"the program has no variable '{name}'; it has {[v.name for v in self.variables]}.")

    def constraint(self, name: str) -> Constraint:
        """Return the constraint of that name; KeyError if there is none."""
        for constraint in self.constraints:
            if constraint.name == name:
                return constraint
        raise KeyError(f"the program has no constraint '{name}'; it has {[c.name for c in self.constraints]}.")

    def sampling(self, name: str) -> Sampling:
        """Nodes and bases of a sum-of-squares constraint."""
        self.constraint(name)
        if name not in self._samplings:
            raise KeyError(f"the constraint '{name}' is not a sum-of-squares constraint and has no nodes.")
        return self._samplings[name]

    def nodes(self, name: str) -> Array:
        """Points (U, n) at which the data of a sum-of-squares constraint are given, as values."""
        return self.sampling(name).nodes

    def values(self, name: str, exponents: ArrayLike, coefficients: ArrayLike) -> Array:
        """Values (..., U) at the nodes of polynomials given by monomial coefficients.

        Parameters
        ----------
        name : str
            A sum-of-squares constraint.
        exponents : (k, n) integers
        coefficients : (..., k)
        """
        table = monomials(self.nodes(name), np.asarray(exponents, dtype=np.int64))
        return np.asarray(np.asarray(coefficients, dtype=np.float64) @ table.T)

    def data(self, *, objective: ArrayLike, constraints: Mapping[str, Iterable[ArrayLike]]) -> Data:
        """Numbers for one program or a batch; see `Data`."""
        return Data.of(self, objective, constraints)

    def zeros(self, batch: tuple[int, ...] = ()) -> Data:
        """Data full of zeros, with writeable arrays, to be filled in place."""
        arrays = {
            c.name: {key: np.zeros((*batch, *shape)) for key, shape in c.shapes(self.size).items()}
            for c in self.constraints
        }
        return Data(self, np.zeros((*batch, self.size)), arrays, batch)


@dataclass(frozen=True, eq=False)
class Data:
    """The numbers of a program, or of a batch of programs of one structure.

    Attributes
    ----------
    structure : Structure
    objective : (..., m)
    constraints : dict of dict of arrays
        Trailing shapes by kind: sos ``c (U,), C (U, m)``; lmi and logdet ``F0 (k, k), F (m, k, k)``; norm
        ``A (k, m), b (k,), g (m,), h ()``; linear ``A (rows, m), b (rows,)``. Leading axes broadcast to `batch`.
    batch : tuple of int
        Shape of the batch; empty for one program.
    """

    structure: Structure
    objective: Array
    constraints: Mapping[str, Mapping[str, Array]]
    batch: tuple[int, ...]

    @staticmethod
    def of(structure: Structure, objective: ArrayLike, constraints: Mapping[str, Iterable[ArrayLike]]) -> Data:
        """Check shapes and finiteness and broadcast the batch axes.

        Raises
        ------
        ValueError
            If a constraint is missing or unknown, an array has the wrong shape, or a number is not finite; the
            sentence names the constraint and the array.
        """
        m = structure.size
        names = [c.name for c in structure.constraints]
        for name in constraints:
            if name not in names:
                raise ValueError(f"data were given for '{name}', which is not a constraint; the program has {names}.")
        batches = []
        q = _array(objective, (m,), "the objective")
        batches.append(q.shape[:-1])
        arrays: dict[str, dict[str, Array]] = {}
        for c in structure.constraints:
            if c.name not in constraints:
                raise ValueError(f"the constraint '{c.name}' has no data; give {tuple(c.shapes(m))}.")
            given = tuple(constraints[c.name])
            shapes = c.shapes(m)
            if len(given) != len(shapes):
                raise ValueError(
                    f"the constraint '{c.name}' needs the arrays {tuple(shapes)}, got {len(given)} arrays."
                )
            arrays[c.name] = {}
            for value, (key, shape) in zip(given, shapes.items(), strict=True):
                array = _array(value, shape, f"the array {key} of the constraint '{c.name}'")
                arrays[c.name][key] = array
                batches.append(array.shape[: array.ndim - len(shape)])
        try:
            batch = np.broadcast_shapes(*batches)
        except ValueError:
            raise ValueError(f"the batch axes of the data do not broadcast: {sorted(set(batches))}.") from None
        return Data(structure, q, arrays, batch)

    def check(self) -> None:
        """Raise ValueError, naming the constraint, if a number is not finite."""
        if not np.all(np.isfinite(self.objective)):
            raise ValueError("the objective holds a NaN or an infinite number; give finite numbers.")
        for name, arrays in self.constraints.items():
            for key, array in arrays.items():
                if not np.all(np.isfinite(array)):
                    raise ValueError(f"the array {key} of the constraint '{name}' holds a NaN or an infinite number.")

    def one(self, position: int) -> tuple[Array, dict[str, dict[str, Array]]]:
        """Objective and arrays of one program of the flattened batch."""
        index = np.unravel_index(position, self.batch) if self.batch else ()
        shapes = {c.name: c.shapes(self.structure.size) for c in self.structure.constraints}

        def pick(array: Array, shape: tuple[int, ...]) -> Array:
            lead = array.shape[: array.ndim - len(shape)]
            own = index[len(index) - len(lead) :] if lead else ()
            return array[tuple(0 if n == 1 else i for i, n in zip(own, lead, strict=True))]

        return (
            pick(self.objective, (self.structure.size,)),
            {
                name: {key: pick(array, shapes[name][key]) for key, array in arrays.items()}
                for name, arrays in self.constraints.items()
            },
        )

    @property
    def count(self) -> int:
        """Number of programs."""
        return int(np.prod(self.batch, dtype=np.int64))


def _array(value: ArrayLike, shape: tuple[int, ...], what: str) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim < len(shape) or array.shape[array.ndim - len(shape) :] != shape:
        raise ValueError(f"{what} must have the shape (..., {', '.join(map(str, shape))}), got {array.shape}.")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{what} holds a NaN or an infinite number; give finite numbers.")
    return array


class Program:
    """A parametric program: minimise a linear objective of d minus log-determinant terms, under constraints on d.

    Describe the variables and constraints, then `compile`. All numbers come later, with `Structure.data`.
    """

    def __init__(self) -> None:
        self._variables: list[Variable] = []
        self._constraints: list[Constraint] = []
        self._size = 0

    def scalar(self, name: str) -> Variable:
        """Add a scalar variable."""
        return self._variable(name, "scalar", (), 1)

    def matrix(self, name: str, shape: tuple[int, ...]) -> Variable:
        """Add an array of free entries, packed row by row."""
        return self._variable(name, "matrix", tuple(shape), int(np.prod(shape, dtype=np.int64)))

    def symmetric(self, name: str, order: int) -> Variable:
        """Add a symmetric matrix (not necessarily positive), packed as its lower triangle row by row."""
        return self._variable(name, "symmetric", (order, order), order * (order + 1) // 2)

    def sos(self, name: str, domain: Domain, degree: int, weights: Iterable[Polynomial] = ()) -> None:
        """Add a constraint f = c + C d >= 0 on a domain, as a (weighted) sum of squares.

        Parameters
        ----------
        name : str
        domain : Domain
            `Sphere`, `Ball`, `Interval`, or a `Product` of them, with its own weights.
        degree : int
            Even degree 2d of f, and of every weighted square; data are f's values at `Structure.nodes`.
        weights : iterable of Polynomial
            Further polynomials g_j: f is required to be non-negative only where all of them are.

        Raises
        ------
        ValueError
            As `aerotube.sos.basis.sampling`, or if the name is taken.
        """
        weights = tuple(weights)
        nodes = sampling(domain, degree, weights).nodes
        self._constraint(Constraint(name, "sos", len(nodes), domain, degree, weights))

    def lmi(self, name: str, size: int) -> None:
        """Add a linear matrix inequality F0 + sum_i d_i F_i >= 0 of symmetric matrices of order `size`."""
        self._constraint(Constraint(name, "lmi", size))

    def logdet(self, name: str, size: int, factor: float = 1.0) -> None:
        """Subtract factor * log det (F0 + sum_i d_i F_i) from the objective to be minimised.

        Raises
        ------
        ValueError
            If `factor` is not positive and finite, or the name is taken.
        """
        if not (np.isfinite(factor) and factor > 0.0):
            raise ValueError(f"the factor of the log-determinant '{name}' must be positive and finite, got {factor}.")
        self._constraint(Constraint(name, "logdet", size, factor=float(factor)))

    def norm(self, name: str, size: int) -> None:
        """Add a norm bound |A d + b| <= g'd + h with a vector of `size` entries."""
        self._constraint(Constraint(name, "norm", size))

    def linear(self, name: str, rows: int) -> None:
        """Add linear inequalities A d <= b."""
        self._constraint(Constraint(name, "linear", rows))

    def compile(self) -> Structure:
        """Freeze the program.

        Raises
        ------
        ValueError
            If the program has no variable.
        """
        if not self._variables:
            raise ValueError("the program has no variable; add one before it is compiled.")
        samplings = {c.name: sampling(c.domain, c.degree, c.weights) for c in self._constraints if c.domain is not None}
        return Structure(tuple(self._variables), tuple(self._constraints), self._size, samplings)

    def _variable(self, name: str, kind: str, shape: tuple[int, ...], size: int) -> Variable:
        if any(v.name == name for v in self._variables):
            raise ValueError(f"the program already has a variable '{name}'; choose another name.")
        if size < 1:
            raise ValueError(f"the variable '{name}' of shape {shape} has no entries.")
        variable = Variable(name, kind, shape, self._size, self._size + size)
        self._variables.append(variable)
        self._size += size
        return variable

    def _constraint(self, constraint: Constraint) -> None:
        if any(c.name == constraint.name for c in self._constraints):
            raise ValueError(f"the program already has a constraint '{constraint.name}'; choose another name.")
        if constraint.size < 1:
            raise ValueError(f"the constraint '{constraint.name}' is empty; its size must be at least 1.")
        self._constraints.append(constraint)
