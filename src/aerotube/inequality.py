"""Polynomial inequalities in words, such as ``"V + 2 alpha^2 <= 1.5"``."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping, Sequence

#: A polynomial: exponents of the variables, and the coefficient of their product.
Terms = Mapping[tuple[int, ...], float]

_MOST_POWER = 20
_HOW = "write it with numbers, names, + - * ^ and one <= or >=, such as V + 2*alpha^2 <= 1.5"


def parse(text: str, names: Sequence[str]) -> dict[tuple[int, ...], float]:
    """Read an inequality between two polynomials.

    Parameters
    ----------
    text : str
        ``left <= right`` or ``left >= right``; ``2 alpha`` may stand for ``2*alpha``, and ``^`` for ``**``.
    names : sequence of str
        Of the variables.

    Returns
    -------
    dict
        The polynomial that is not negative where the inequality holds: coefficients by exponents, none zero.

    Raises
    ------
    ValueError
        If it is no such inequality, names something else, or does not depend on a variable.
    """
    sides = re.split(r"<=|>=", text)
    if len(sides) != 2:
        raise ValueError(f'"{text}" is no inequality; {_HOW}')
    left, right = (_polynomial(side, text, names) for side in sides)
    larger, smaller = (right, left) if "<=" in text else (left, right)
    found = _sum(larger, smaller, -1.0)
    if not all(math.isfinite(value) for value in found.values()):
        raise ValueError(f'"{text}" has a number that is too large; give finite ones')
    if not any(any(powers) for powers in found):
        raise ValueError(f'"{text}" does not depend on any error; name at least one of {", ".join(names)}')
    return found


def _polynomial(side: str, text: str, names: Sequence[str]) -> dict[tuple[int, ...], float]:
    source = re.sub(r"(?<![\w.])(\d+\.?\d*(?:[eE][+-]?\d+)?)\s+(?=[A-Za-z(])", r"\1*", side).replace("^", "**").strip()
    try:
        tree = ast.parse(source, mode="eval").body
    except (SyntaxError, ValueError):
        raise ValueError(f'"{text}" cannot be read; {_HOW}') from None
    return _value(tree, text, names)


def _value(node: ast.expr, text: str, names: Sequence[str]) -> dict[tuple[int, ...], float]:
    none = (0,) * len(names)
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int() | float() as number):
            return {none: float(number)}
        case ast.Name(id=name) if name in names:
            return {tuple(int(other == name) for other in names): 1.0}
        case ast.Name(id=name):
            raise ValueError(f'"{text}" has the unknown name {name}; known are {", ".join(names)}')
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _sum({}, _value(operand, text, names), -1.0)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            sign = 1.0 if isinstance(op, ast.Add) else -1.0
            return _sum(_value(left, text, names), _value(right, text, names), sign)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return _product(_value(left, text, names), _value(right, text, names))
        case ast.BinOp(left=left, op=ast.Div(), right=ast.Constant(value=int() | float() as number)) if number:
            return _product(_value(left, text, names), {none: 1.0 / number})
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))) if 0 <= power <= _MOST_POWER:
            out = {none: 1.0}
            base = _value(left, text, names)
            for _ in range(power):
                out = _product(out, base)
            return out
        case _:
            pass
    raise ValueError(f'"{text}" cannot be read; {_HOW}')


def _sum(first: Terms, second: Terms, sign: float) -> dict[tuple[int, ...], float]:
    total = {powers: first.get(powers, 0.0) + sign * second.get(powers, 0.0) for powers in {**first, **second}}
    return {powers: value for powers, value in total.items() if value != 0.0}


def _product(first: Terms, second: Terms) -> dict[tuple[int, ...], float]:
    out: dict[tuple[int, ...], float] = {}
    for a, x in first.items():
        for b, y in second.items():
            powers = tuple(i + j for i, j in zip(a, b, strict=True))
            out[powers] = out.get(powers, 0.0) + x * y
    return {powers: value for powers, value in out.items() if value != 0.0}
