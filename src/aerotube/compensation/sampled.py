r"""Bounds of tubes from samples of the true map.

The size of a tube, the largest :math:`x^{+T} E x^+` over a set, is estimated from below by everything that is tried:
independent samples of the set, and ascents from the worst of them and from the worst points of the linearised map.
See :mod:`aerotube.compensation.worst_points`.

What may be said of the largest value found, `FACTOR` times which is the bound: the samples being N independent draws
from a distribution on the set, with confidence ``1 - (1 - s)^N`` the points whose size exceeds it have a share of at
most s in that distribution, for each beat and part by itself (R. Tempo, E. W. Bai, F. Dabbene, "Probabilistic
robustness analysis: explicit bounds for the minimum number of samples", Systems & Control Letters 30, 1997). Ascents
and factor only make it larger; they are there so that a search much longer than this one finds nothing above it.

The distribution: each ball (the part's errors, the other half's) by itself, uniform on its surface with probability one
half and uniform inside otherwise; each interval (a parameter, a measurement error, a component of the wind) by itself,
one of its ends with probability one half and uniform otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation.bounds import SHARES, Bound
from aerotube.compensation.covers import sum_around
from aerotube.compensation.settings import Part
from aerotube.compensation.worst_points import QUICK, THOROUGH, Mask, Search, sizes_of
from aerotube.dynamics import BeatSet

Array = NDArray[np.float64]

#: What the largest size found is multiplied by, in the metric of a tube and in its terminal ellipsoid, which may be a
#: sliver in which only what is not linear is seen. A search of a million points a beat on the manoeuvre of Table 2 went
#: 0.6 and 4 percent beyond what was found here, at the most; these are about twice as much.
FACTOR, TERMINAL_FACTOR = 1.01, 1.1


def sizes(search: Search, parts: Sequence[Part], forms: Sequence[Array]) -> Array:
    """Sampled bounds of the sizes of parts, and nothing else of what :func:`bound` gives: for use in flight.

    Parameters
    ----------
    search : Search
        Over the whole set of the beats.
    parts : sequence of Part
    forms : sequence of ndarray (b, n, n)
        The metric of each.

    Returns
    -------
    ndarray (b, parts)
        Infinite where a flight was not finite.
    """
    every = np.ones(search.size, dtype=bool)
    pairs = list(zip(parts, forms, strict=True))
    found = search.together([search.task(part.errors, form, every, search.usual) for part, form in pairs])
    moved = [point[:, None] * _off_extremes(search) for _, point in found]
    ends = np.split(search.fly(np.concatenate(moved, axis=1)), len(parts), axis=1)
    out = [
        np.maximum(value, sizes_of(end[..., list(part.errors)], form).max(axis=1))
        for (part, form), (value, _), end in zip(pairs, found, ends, strict=True)
    ]
    return np.asarray(FACTOR * np.nan_to_num(np.stack(out, axis=1), nan=np.inf))


def bound(search: Search, part: Part, form: Array, polynomial: Array) -> Bound:
    """Sampled bounds of the tubes of a part.

    Parameters
    ----------
    search : Search
        Over the whole set of the beats.
    part : Part
    form : ndarray (b, n, n)
        The metric.
    polynomial : ndarray (b,)
        Bounds of the polynomials; the sampled ones are no less.

    Returns
    -------
    Bound
        Without the share of the control's nonlinearity.
    """
    own = list(part.errors)
    polynomial = np.where(np.isfinite(polynomial), polynomial, 0.0)
    level, shares = polynomial, np.zeros((search.beats, len(SHARES)))
    point = np.zeros((search.beats, search.size))
    sound = search.sound.copy()
    levels = _levels(search.over, part)
    whole = max(row for row, free in enumerate(levels) if free is not None)
    for row, free in enumerate(levels):
        if row == SHARES.index("parameters"):
            value = _inside(search, point, own, form)
        elif free is None:
            continue
        else:
            value, point = search.largest(own, form, free, search.usual if row == whole else QUICK)
        sound &= np.isfinite(value)
        reached = np.where(sound, np.maximum(level, FACTOR * value), level)
        shares[:, row], level = reached - level, reached
    shape = _terminal_shape(search, own)
    found, _ = search.largest(own, shape, np.ones(search.size, dtype=bool), THOROUGH)
    found = np.maximum(found, sizes_of(search.others[..., own], shape).max(axis=1))
    control = np.zeros(search.beats)
    holds = sound & np.isfinite(found)
    why = "a flight of its samples was not finite"
    return Bound(holds, level, shares, control, shape, TERMINAL_FACTOR * found, why)


def _levels(over: BeatSet, part: Part) -> list[Mask | None]:
    """Which variables are free for each of `SHARES`, more and more of them; None where nothing is added."""
    kinds = np.repeat([name.split(" ")[0] for name in over.names], over.balls)
    others = (kinds != part.name) & (np.repeat(over.balls, over.balls) > 1)
    noise, wind = kinds == "measurement", kinds == "wind"
    free = ~(others | noise | wind)
    levels: list[Mask | None] = [free.copy(), None]
    for added in (others, noise, wind):
        free = free | added
        levels.append(free if added.any() else None)
    return levels


def _inside(search: Search, point: Array, own: list[int], form: Array) -> Array:
    """Largest size at points (b, k) with the parameters moved off their extremes."""
    ends = search.fly(point[:, None] * _off_extremes(search))
    return np.asarray(sizes_of(ends[..., own], form).max(axis=1))


def _off_extremes(search: Search) -> Array:
    """Factors (3, k) that move the parameters off their extremes."""
    over = search.over
    pairs = zip(over.names, over.balls, strict=True)
    known = np.array([" " not in name and size == 1 for name, size in pairs])
    shrink = np.ones((3, search.size))
    shrink[:, np.repeat(known, over.balls)] = np.array([[-0.5], [0.0], [0.5]])
    return shrink


def _terminal_shape(search: Search, own: list[int]) -> Array:
    """Shapes around the sum of what each ball does linearly, and of all that is not linear: ndarray (b, n, n)."""
    slopes, start = search.slopes[:, own], 0
    centre = search.centre[:, own]
    pieces = [centre[:, :, None] * centre[:, None]]
    for size in search.over.balls:
        column = slopes[:, :, start : start + size]
        pieces.append(column @ np.swapaxes(column, 1, 2))
        start += size
    left = search.ends[..., own] - centre[:, None] - search.points @ np.swapaxes(slopes, 1, 2)
    left = np.where(np.isfinite(left), left, 0.0)
    spread = np.swapaxes(left, 1, 2) @ left / left.shape[1]
    # in no direction less than a millionth of what there is in all, so that the shape has an inverse
    scale = np.sqrt(np.diagonal(sum(pieces) + spread, axis1=1, axis2=2))
    spread = spread + 1e-12 * scale[:, :, None] * np.eye(len(own)) * scale[:, None]
    reach = np.sum((left @ np.linalg.inv(spread)) * left, axis=-1).max(axis=1)
    pieces.append(spread * np.maximum(reach, 1.0)[:, None, None])
    return np.asarray(np.linalg.inv(sum_around(np.stack(pieces))))


def with_control(given: Bound, search: Search, flat: Search, part: Part, form: Array, polynomial: Array) -> Bound:
    """The bound with the share of the control's nonlinearity: the bend that the law adds to the fitted map.

    Parameters
    ----------
    given : Bound
    search, flat : Search
        With the law, and without it.
    part : Part
    form : ndarray (b, n, n)
    polynomial : ndarray (b,)

    Returns
    -------
    Bound
    """
    own, first = list(part.errors), search.over.columns(part.name)
    z = search.points[:, first]
    bends = (search.bends[:, :, first, first] - flat.bends[:, :, first, first])[:, own]
    bent = 0.5 * np.einsum("bnij,ui,uj->bun", bends, z, z, optimize=True)
    norm = np.sqrt(sizes_of(bent, form).max(axis=1))
    root = np.sqrt(np.where(np.isfinite(polynomial), polynomial, 0.0))
    return replace(given, control=root**2 - np.maximum(root - norm, 0.0) ** 2)
