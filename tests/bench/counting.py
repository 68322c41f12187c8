# SPDX-License-Identifier: GPL-3.0-or-later
"""What a morph and a removal have done, in operations: the same on every machine, however busy it is.

    .venv/bin/python tests/bench/counting.py [--write]

Prints the counts of a morph of two bones of our own making, and of two balls pushed apart; ``--write``
makes them the committed ones in counts.json and counts_overclosure.json, which tests/test_counts.py holds
the code to.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT)]

from femors_addon import cells, common, grnn, intersect, nearest, relax, shapes, triangles  # noqa: E402
from femors_addon.bodies import Body  # noqa: E402
from femors_addon.morph import morph  # noqa: E402
from femors_addon.overclosure import remove_overclosure  # noqa: E402

COMMITTED = Path(__file__).with_name("counts.json")
COMMITTED_REMOVAL = Path(__file__).with_name("counts_overclosure.json")
NODES = 6000
DEEP = 0.5  # of two balls of radius 10 and 8, of 2562 nodes each

Amount = Callable[..., int]

PLACES: tuple[tuple[str, Any, str, Amount], ...] = (
    ("closest-point queries", nearest.SurfaceIndex, "closest", lambda self, points, *a, **k: len(points)),
    ("point-face pairs", triangles.Triangles, "closest", lambda self, p, ids: len(ids)),
    ("fields evaluated at points", grnn.DisplacementField, "__call__", lambda self, p, *a: len(p)),
    ("grid cells", grnn._Grid, "smooth", lambda self, *a: math.prod(self.shape)),
    ("face pairs tested for crossing", intersect, "straddling", lambda one, f, two, g: len(f)),
    (
        "kernel pairs",
        cells._Meetings,
        "blocks",
        lambda self: int((self.count * self.length.sum(axis=1)).sum()),
    ),
    (
        "triangle pairs for volumes",
        common,
        "_heights",
        lambda corners, others: len(corners),
    ),
    ("faces matched in shape", relax.ShapeMatching, "move", lambda self, p: len(self._corners[0])),
)


@contextmanager
def counting() -> Iterator[Counter[str]]:
    """Count operations while the context lasts."""
    total: Counter[str] = Counter()
    originals = []

    def counted(label: str, original: Any, amount: Amount) -> Any:
        def wrapper(*args: Any, **options: Any) -> Any:
            total[label] += amount(*args, **options)
            return original(*args, **options)

        return wrapper

    for label, owner, name, amount in PLACES:
        original = getattr(owner, name)
        originals.append((owner, name, original))
        setattr(owner, name, counted(label, original, amount))
    try:
        yield total
    finally:
        for owner, name, original in originals:
            setattr(owner, name, original)


def of_a_morph(nodes: int = NODES) -> dict[str, int]:
    """Count what a morph of two bones of our own making takes."""
    pair = shapes.pair(nodes)
    with counting() as total:
        morph(pair.source, pair.target)
    return dict(sorted(total.items()))


def of_a_removal(deep: float = DEEP) -> dict[str, int]:
    """Count what it takes to push two balls apart."""
    one = shapes.sphere(4, radius=10.0)
    apart = (18.0 - deep) / 3.0
    two = shapes.sphere(4, radius=8.0, centre=(2.0 * apart, 2.0 * apart, apart))
    with counting() as total:
        remove_overclosure([Body("one", one), Body("two", two)])
    return dict(sorted(total.items()))


def main() -> int:
    """Print the counts beside the committed ones."""
    parser = argparse.ArgumentParser(description="Count the operations of a morph and of a removal")
    parser.add_argument("--write", action="store_true", help="make them the committed ones")
    args = parser.parse_args()
    for path, found in ((COMMITTED, of_a_morph()), (COMMITTED_REMOVAL, of_a_removal())):
        if args.write:
            path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        committed = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        print(path.name)
        for label, count in found.items():
            before = committed.get(label, 0)
            print(f"{label:34}{count:14,}{(count / before - 1) if before else 0:+8.1%}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
