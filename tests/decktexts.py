# SPDX-License-Identifier: GPL-3.0-or-later
"""A small Abaqus deck as text, and how tests read one."""

from __future__ import annotations

from pathlib import Path

import pytest

from femors_addon import deckfiles
from femors_addon.deck import Deck
from femors_addon.progress import FemorsError

TETS = """*HEADING
Two tetrahedra, and what else a deck has
** a comment
*Node, nset=All
      1,           0.,           0.,           0.
      2,           1.,           0.,  0.000
** a comment among nodes, 1, 2, 3

\t3,\t0.0\t,\t1.0D+00,\t-0.
  4, 0, 0, 1.e0 ,
      5,  1 , 1,  1
*ELEMENT, TYPE=C3D4, ELSET=Body
1, 1, 2, 3, 4
2, 2,
** a comment within an element
  3, 4,
 5
*Nset, nset=Even, generate
2, 4, 2
*NSET,NSET="with blank"
Even, 5
*Elset, elset=both
1, 2
*Elset, elset=_top_S3, internal
2
*Surface, type=ELEMENT, name=Top
_top_S3, S3
*Material, name=Steel
*Elastic
210000., 0.3
*Step
*Static
*Node Output
U,
*End Step
"""


ASSEMBLY = """*Heading
*Part, name=Femur
*Node
1, 0, 0, 0
2, 1, 0, 0
3, 0, 1, 0
4, 0, 0, 1
9, 9, 9, 9
*Element, type=C3D4
1, 1, 2, 3, 4
*Nset, nset=tip
4
*Elset, elset=solid
1
*End Part
*Part, name=Plate
*Node
1, 0, 0, 0
2, 2, 0, 0
3, 0, 2, 0
*Element, type=S3
1, 1, 2, 3
*Nset, nset=tip
3
*End Part
*Assembly, name=A
*Instance, name=Femur-1, part=Femur
 10., 0., 0.
 10., 0., 0., 10., 0., 1., 90.
*End Instance
*Instance, name=Plate-1, part=plate
*End Instance
*Node
1, 5, 5, 5
*Nset, nset=point
1,
*Nset, nset=far, instance=Femur-1
2, 3
*Nset, nset=both
Femur-1.tip, Plate-1.tip
*Elset, elset=e, instance=Plate-1, generate
1, 1, 1
*Surface, type=element, name=under, instance=Femur-1
1, S1
*Surface, type=element, name=skin
Femur-1.solid,
*End Assembly
"""


def deck_of(path: Path, content: str | bytes, name: str = "deck.inp") -> Deck:
    path = path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return deckfiles.read_deck(path)


def refused(path: Path, content: str | bytes, *words: str) -> str:
    """Assert that reading fails in one line that names the file and says the words."""
    with pytest.raises(FemorsError) as caught:
        deck_of(path, content)
    text = str(caught.value)
    assert text.startswith(str(path / "deck.inp")), text
    assert "\n" not in text
    for word in words:
        assert word in text, text
    return text
