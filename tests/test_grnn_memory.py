# SPDX-License-Identifier: GPL-3.0-or-later
"""What the GRNN takes of memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
from grnncases import around, smooth

from femors_addon import shapes
from femors_addon.grnn import DisplacementField


def peak(work) -> float:
    """Peak of memory that a call allocates, in MB."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


def test_memory_is_bounded_by_blocks():
    """Never N x M: whole matrices would be 288 MB for the definition and 3.2 GB for the fast ways."""
    small = shapes.sphere(4, radius=100.0).vertices
    centres = np.concatenate([small * (1 + 0.01 * k) for k in range(3)])[:6000]
    field = DisplacementField(centres, smooth(centres), 5.0)
    at = around(centres, 1.0, 6000)
    assert peak(lambda: field.exact(at)) < 90.0
    for layers in (8, 32):  # four times as many centres ask for hardly more
        many = np.concatenate([small * (1 + 0.005 * k) for k in range(layers)])
        at = around(many, 1.0, 20_000)
        for spread in (1.0, 60.0):
            field = DisplacementField(many, smooth(many), spread)
            assert peak(lambda field=field, at=at: field(at)) < 140.0, spread
