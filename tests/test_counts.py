# SPDX-License-Identifier: GPL-3.0-or-later
"""Operations of a morph and of a removal against the committed counts: a change must be meant."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np

from femors_addon import shapes
from femors_addon.nearest import SurfaceIndex

HERE = Path(__file__).resolve().parent
_spec = importlib.util.spec_from_file_location("counting", HERE / "bench" / "counting.py")
assert _spec is not None and _spec.loader is not None
counting = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(counting)

MEANT = 0.2
"""Change of a count that nobody needs to have meant; `tests/bench/counting.py --write` commits others."""


def test_a_morph_takes_as_many_operations_as_committed():
    compare(counting.COMMITTED, counting.of_a_morph())


def test_a_removal_takes_as_many_operations_as_committed():
    compare(counting.COMMITTED_REMOVAL, counting.of_a_removal())


def compare(path: Path, found: dict[str, int]) -> None:
    committed = json.loads(path.read_text(encoding="utf-8"))
    assert found.keys() == committed.keys()
    off = {
        name: (committed[name], count)
        for name, count in found.items()
        if abs(count - committed[name]) > MEANT * committed[name]
    }
    assert not off, "counts have changed; if that is meant: tests/bench/counting.py --write"


def test_counting_counts_and_leaves_no_trace():
    ball = shapes.sphere(2)
    before = SurfaceIndex.closest
    with counting.counting() as total:
        SurfaceIndex(ball).closest(np.zeros((7, 3)))
    assert total["closest-point queries"] == 7
    assert total["point-face pairs"] >= 7
    assert SurfaceIndex.closest is before
