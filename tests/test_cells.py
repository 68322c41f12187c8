# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of centres: who meets whom, and in blocks of what size."""

from __future__ import annotations

import numpy as np

from femors_addon import cells


def crowded():
    """Queries and centres from far apart to a thousand in one place, which is where meetings differ most."""
    random = np.random.default_rng(5)
    heap = random.normal(scale=0.05, size=(1500, 3))
    return np.concatenate((heap, random.uniform(-6.0, 6.0, (1500, 3)), [[40.0, 0.0, 0.0]]))


def test_each_query_meets_all_centres_of_the_cells_around_it_once(monkeypatch):
    monkeypatch.setattr(cells, "TOGETHER", 20_000)
    points = crowded()
    found = cells.Cells.of(points, 1.0)
    cell = np.floor((points - found.low) / found.size).astype(np.int64)
    near = (np.abs(cell[:, None] - cell) <= 1).all(axis=2)
    got = found.sums(np.ones((len(points), 1)), 1e9, points)[:, 0]
    np.testing.assert_array_equal(got, near.sum(axis=1))


def test_a_block_of_meetings_is_little_filled_up(monkeypatch):
    """However crowded a place, no block takes more memory than was meant."""
    monkeypatch.setattr(cells, "TOGETHER", 20_000)
    monkeypatch.setattr(cells, "LARGEST", 40_000)
    points = crowded()
    found = cells.Cells.of(points, 1.0)
    keys = np.sort(found._key(cells._cell(points, found.low, found.size)))
    meetings = found._meetings(keys)
    blocks = meetings.blocks()
    assert [block.start for block in blocks] == [0, *(block.stop for block in blocks[:-1])]
    assert blocks[-1].stop == len(meetings.count)
    met = []
    for block in blocks:
        query, (index, filling) = meetings.queries(block), meetings.centres(block)
        assert (filling.sum(axis=1) < 0.5 * index.shape[1]).all()
        least = cells.FEWEST * index.shape[1]  # of the queries of one cell
        assert query.size * index.shape[1] <= max(2 * cells.TOGETHER, cells.LARGEST, least) + least
        met.append(query)
    assert set(np.concatenate([query.ravel() for query in met])) == set(range(len(points)))


def test_products_of_matrices_stay_below_where_openblas_locks():
    for each in (5, 5_000, 50_000):
        for count in range(1, cells.MOST_QUERIES + 1):
            filled = int(cells._filled(np.array([count]))[0])
            assert filled >= count and filled - count < 16 and (count > 32 or filled - count < 4)
            query = cells._in_parts(np.arange(filled)[None], each)
            assert query.size == filled
            size = query.shape[2]
            assert size * each <= cells.LOCKED or size % 2 or size <= cells.FEWEST
            assert size == filled or size >= cells.FEWEST // 2
