# SPDX-License-Identifier: GPL-3.0-or-later
"""What is told of each row of three, column by column.

NumPy reduces an axis of length three, one short row after the other, four to ten times slower than it
goes along three columns. The results have the same bits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

LARGEST = 1e30
"""Of a coordinate: what is worked with stays a number in single precision and to the tenth power."""


def unfit(positions: Float) -> Mask | None:
    """Return which rows (n,) of finite positions (n, 3) are too large; None where none is."""
    if not positions.size or (positions.min() >= -LARGEST and positions.max() <= LARGEST):
        return None
    return some(np.abs(positions) > LARGEST)


def complaint(bad: Mask, things: str, called: Callable[[int], object]) -> str:
    """Return what to say of the rows (n,) that `unfit` has found; `called` says what a row is called."""
    first = called(int(np.argmax(bad)))
    return f"{int(bad.sum())} of {len(bad)} {things} with coordinates beyond {LARGEST:g} (first: {first})"


def every(mask: Mask) -> Mask:
    """Whether all three are true, of rows (n, 3)."""
    out: Mask = mask[:, 0] & mask[:, 1]
    out &= mask[:, 2]
    return out


def some(mask: Mask) -> Mask:
    """Whether one of three is true, of rows (n, 3)."""
    out: Mask = mask[:, 0] | mask[:, 1]
    out |= mask[:, 2]
    return out


def least(values: NDArray) -> NDArray:
    """Return the smallest (n, ...) of three: of values (n, 3, ...)."""
    return np.minimum(np.minimum(values[:, 0], values[:, 1]), values[:, 2])


def greatest(values: NDArray) -> NDArray:
    """Return the greatest (n, ...) of three: of values (n, 3, ...)."""
    return np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2])


def dot(a: Float, b: Float) -> Float:
    """Return the products (n,) of the rows of two arrays (n, 3)."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


def cross(a: Float, b: Float) -> Float:
    """Return the cross products (n, 3) of the rows of two arrays (n, 3)."""
    out = np.empty(a.shape)
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return out


def crossed(a: Float, b: Float, c: Float) -> Float:
    """Return the normals (m, 3) of triangles with corners (m, 3), as long as twice their areas."""
    return cross(b - a, c - a)


def unit(vectors: Float) -> Float:
    """Normalise the rows (n, 3); rows of zero length, or too short to be squared, are zero."""
    size = length(vectors)
    size[size == 0] = np.inf
    return np.asarray(vectors / size[:, None])


def total(values: NDArray) -> NDArray:
    """Return the sum (n, ...) of three: of values (n, 3, ...)."""
    return np.asarray(values[:, 0] + values[:, 1] + values[:, 2])


def squared(vectors: Float) -> Float:
    """Return the squared lengths (n,) of rows (n, 3)."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    out: Float = x * x
    out += y * y
    out += z * z
    return out


def length(vectors: Float) -> Float:
    """Return the lengths (n,) of rows (n, 3)."""
    return np.asarray(np.sqrt(squared(vectors)))


def box(points: Float) -> tuple[Float, Float]:
    """Return the lowest and the highest corner (3,) of the box around points (n, 3), n > 0."""
    low = np.array([points[:, axis].min() for axis in range(3)])
    return low, np.array([points[:, axis].max() for axis in range(3)])


def longest_squared(corners: Float) -> Float:
    """Return the squared length (m,) of the longest side of triangles (m, 3, 3)."""
    return longest_side(corners[:, 0], corners[:, 1], corners[:, 2])


def longest_side(a: Float, b: Float, c: Float) -> Float:
    """Return the squared length (m,) of the longest side of triangles with corners (m, 3)."""
    out = np.maximum(squared(b - a), squared(c - b))
    return np.asarray(np.maximum(out, squared(a - c), out=out))


def renumbered(indices: NDArray, count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return (those that occur, ascending; indices by their rank among these); all are below `count`.

    As ``numpy.unique(return_inverse=True)``, without a sort.
    """
    used = np.zeros(count, dtype=bool)
    used[indices] = True
    which = np.flatnonzero(used).astype(np.int32)
    rank = np.empty(count, dtype=np.int32)
    rank[which] = np.arange(len(which), dtype=np.int32)
    return which, rank[indices]


def different(rows: NDArray) -> int:
    """Return how many different rows (n, 3) of finite numbers there are, by a hash: now and then too few."""
    bits = np.ascontiguousarray(rows, dtype=np.float64) + 0.0  # of zeros the positive one
    keys = np.zeros(len(rows), dtype=np.uint64)
    for column in bits.view(np.uint64).T:
        keys ^= column
        keys *= np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(32)
    keys.sort()
    return len(keys) - int(np.count_nonzero(keys[1:] == keys[:-1]))


def are_unique(rows: NDArray) -> bool:
    """Whether no two rows (n, 3) of finite numbers are equal: now and then wrongly not.

    A tenth of the time of `unique_rows`, which has nothing to do then.
    """
    return different(rows) == len(rows)


def placed(rows: NDArray) -> tuple[NDArray, NDArray]:
    """Return (the first index of each different row, in their order; for each row which of these it is)."""
    if are_unique(rows):
        return (np.arange(len(rows)),) * 2
    first, inverse = unique_rows(rows)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse]


def unique_rows(rows: NDArray) -> tuple[NDArray, NDArray]:
    """Return (for each different row its first index, for each row which of these it is).

    As ``numpy.unique(axis=0)``, in a fraction of the time, and other threads can run meanwhile.
    """
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = False
    for axis in range(rows.shape[1]):
        new[1:] |= ordered[1:, axis] != ordered[:-1, axis]
    inverse = np.empty(len(rows), dtype=np.int64)
    inverse[order] = np.cumsum(new) - 1
    return order[new], inverse
