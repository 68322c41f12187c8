# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables in a narrow sidebar: names first, what is told below the table too is left out."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import pytest
from drawn import Layout, sidebar


@pytest.mark.parametrize(("width", "scale", "little"), [(200, 1, True), (280, 1, False), (280, 2, True)])
def test_a_pair_keeps_both_names_and_its_state(empty, part, width, scale, little):
    """Depth and tick are below the table, where the width leaves them out of the row."""
    rows = part("ui.overclosure").FEMORS_UL_pairs
    pair = SimpleNamespace(one="Femur", two="Tibia", state="overlap", depth=0.25, exclude=False)
    layout = Layout()
    rows.draw_item(None, sidebar(width, scale), layout, None, pair, 0, None, "")
    assert layout.said == ["Femur", "Tibia", "---", *([] if little else ["0.25"]), "CANCEL"]
    assert layout.buttons == ([] if little else ["exclude"])


def test_a_landmark_is_told_of_in_words_or_in_heads(empty, part):
    transfer = part("ui.transfer")
    mark = bpy.context.scene.femors_transfer.marks.add()
    mark.name, mark.residual = "Head", 0.0123
    said = {}
    for little in (False, True):
        layout = Layout()
        transfer.draw_mark(layout, mark, 1.0, little)
        said[little] = layout.said
    assert "Target away from the morph" in said[False] and "Fit" in said[True]
    assert max(map(len, said[True])) < 12 and "0.012" in said[True]
