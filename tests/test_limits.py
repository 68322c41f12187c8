# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits that hold, and that change no result."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from surfaces import soup

from femors_addon import balls, cells, crew, frames, grnn, limits, nearest, overclosure
from femors_addon.carry import Carrier
from femors_addon.examine import examine
from femors_addon.grnn import DisplacementField
from femors_addon.intersect import crossings, piercings
from femors_addon.keptfield import KeptField
from femors_addon.morph import morph
from femors_addon.nearest import SurfaceIndex
from femors_addon.overclosure import Body, check_overclosure, remove_overclosure
from femors_addon.progress import FemorsError
from femors_addon.regions import RegionMap
from femors_addon.shapes import pair, sphere, warp
from femors_addon.transfer import Transfer
from femors_addon.transfer_settings import TransferSettings


@pytest.fixture(autouse=True)
def restored(monkeypatch):
    monkeypatch.setattr(overclosure, "LARGE", 0)  # threads for small bodies too
    before = limits.Limits.threads, limits.Limits.memory
    yield
    limits.Limits.threads, limits.Limits.memory = before


BONES = pair(2000, 2000)
BALLS = [Body("one", sphere(3, radius=10.0)), Body("two", sphere(3, radius=10.0, centre=(19.0, 1.0, 0.0)))]


def carrier() -> Carrier:
    rest = BONES.source.vertices
    bent = warp(rest, ("bend", 0.1)) - rest
    kept = KeptField(np.eye(4), rest, bent, BONES.source.faces, np.zeros(len(rest)), BONES.source.mean_edge)
    return Carrier(kept)


def closest():
    return SurfaceIndex(BONES.source).closest(BONES.target.vertices).point


def transferred():
    return Transfer(carrier(), TransferSettings(), BONES.target).points(BONES.target.vertices).points


def transferred_back():
    back = Transfer(carrier(), TransferSettings(inverse=True))
    return back.points(np.tile(BONES.source.vertices, (3, 1)) + 2.0).points


def field(edges):
    """With a spread of so many mean edges."""
    rest = BONES.source.vertices
    return DisplacementField(rest, warp(rest, ("bend", 0.1)) - rest, edges * BONES.source.mean_edge)(
        BONES.target.vertices
    )


def field_by_cells():
    return field(0.5)


def field_by_grid():
    return field(12.0)


def crossed():
    other = BONES.source.moved(BONES.source.vertices[:, [1, 0, 2]])
    found = piercings(BONES.source, other)
    return np.concatenate((crossings(BONES.source, other).ravel(), found.edge, found.face, found.t))


def examined():
    return json.dumps(examine(BONES.source, BONES.target).as_dict())


def separated():
    return np.concatenate([body.nodes for body in remove_overclosure(BALLS).bodies])


JOBS = (
    closest,
    transferred,
    transferred_back,
    field_by_cells,
    field_by_grid,
    crossed,
    examined,
    separated,
)


@pytest.mark.parametrize("job", JOBS)
def test_threads_change_no_bit(job, monkeypatch):
    monkeypatch.setattr(nearest, "BLOCK_PAIRS", 4000)  # so that there are several blocks
    monkeypatch.setattr(frames, "BLOCK", 500)
    monkeypatch.setattr(grnn, "ASKED", 500)
    monkeypatch.setattr(cells, "TOGETHER", 10_000)
    monkeypatch.setattr(balls, "AT_ONCE", 500)
    monkeypatch.setattr(crew, "BLOCK", 300)
    limits.allow(1, 0)
    one = job()
    started = set()
    thread = crew.threading.Thread
    monkeypatch.setattr(
        crew.threading, "Thread", lambda **more: started.add(limits.Limits.threads) or thread(**more)
    )
    for threads in (2, 3):
        limits.allow(threads, 0)
        np.testing.assert_array_equal(job(), one)
    assert {2, 3} <= started, "it runs in threads at all"


def test_no_threads_asked_are_all_there_are():
    limits.allow(0, 0)
    assert limits.Limits.threads == os.cpu_count()


def measure_only(progress):
    examine(BONES.source, progress=progress)


def measure_both(progress):
    examine(BONES.source, BONES.target, progress=progress)


def morph_it(progress):
    morph(BONES.source, BONES.target, progress=progress)


def carry_it(progress):
    Transfer(carrier(), TransferSettings(), BONES.target).points(BONES.target.vertices, progress)


def carry_regions(progress):
    RegionMap(BONES.source, BONES.target, progress)


def remove_it(progress):
    remove_overclosure(BALLS, progress=progress)


def check_it(progress):
    check_overclosure(BALLS, progress=progress)


@pytest.mark.parametrize(
    ("job", "words"),
    [
        (morph_it, r"a morph with 3964 nodes in both meshes needs about 39 MB"),
        (measure_only, r"measuring a mesh with 1990 nodes in all needs about 15 MB"),
        (measure_both, r"measuring a mesh with 3964 nodes in all needs about 20 MB"),
        (carry_it, r"a transfer with 5938 nodes in all needs about 61 MB"),
        (carry_regions, r"carrying regions with 3964 nodes in all needs about 7 MB"),
        (remove_it, r"overclosure of 2 bodies with 1284 nodes in all needs about 13 MB"),
        (check_it, r"overclosure of 2 bodies with 1284 nodes in all needs about 13 MB"),
    ],
)
def test_what_needs_too_much_memory_is_refused_before_it_starts(job, words):
    said = []
    limits.allow(1, 5)
    with pytest.raises(FemorsError, match=words + r".*, and the limit in the preferences is 5 MB: raise it"):
        job(lambda fraction, text: said.append(text))
    assert not said
    limits.allow(1, 0)
    limits.require_memory(1e15, "anything")


def test_memory_is_asked_for_the_nodes_of_an_stl_file_not_for_its_corners():
    one, two = soup(BONES.source), soup(BONES.target)
    balls = [Body(ball.name, soup(ball.mesh)) for ball in BALLS]
    limits.allow(1, 5)
    for job, words in (
        (lambda: morph(one, two), "a morph with 3964 nodes in both meshes needs about 39 MB"),
        (lambda: examine(one, two), "measuring a mesh with 3964 nodes in all needs about 20 MB"),
        (
            lambda: remove_overclosure(balls),
            "overclosure of 2 bodies with 1284 nodes in all needs about 13 MB",
        ),
        (lambda: Transfer(carrier(), TransferSettings()).points(two.vertices), "a transfer with 3964 nodes"),
    ):
        with pytest.raises(FemorsError, match=words):
            job()


def test_each_further_thread_needs_memory_too():
    for threads, words in ((1, "39 MB"), (2, "47 MB"), (3, "55 MB")):
        limits.allow(threads, 5)
        with pytest.raises(FemorsError, match=f"needs about {words}"):
            morph(BONES.source, BONES.target)


def test_corners_of_one_node_are_carried_once_and_alike(monkeypatch):
    transfer, asked = Transfer(carrier(), TransferSettings()), []
    carry = Carrier.carry
    monkeypatch.setattr(
        Carrier, "carry", lambda self, points, *rest: asked.append(points) or carry(self, points, *rest)
    )
    nodes, corners = BONES.target.vertices, soup(BONES.target).vertices
    one, many = transfer.points(nodes), transfer.points(corners)
    assert [len(points) for points in asked] == [len(nodes), len(nodes)]
    assert len(np.unique(many.points, axis=0)) == len(nodes)
    np.testing.assert_allclose(many.points, one.points[BONES.target.faces.ravel()], atol=1e-9)
