# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses: principal frames, and the start of an alignment found among all the ways to lay them together."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from .icp import Cloud, Fit, Registration, icp, matched, unlike
from .mesh import Float
from .transforms import homogeneous, inverse, transformed

SCOUTS = 250  # nodes that starts are compared with
TOGETHER = 32  # starts that are looked at side by side: what they need stays in the processor's cache
SLACK = 10.0  # factor on the tolerance, as long as starts are compared
WHOLE_STARTS, PARTIAL_STARTS = 25, 10  # that are tried by ICP after the first look
WHOLE_ROUNDS = ((5, 30), (10, 12))  # steps of ICP for each start, and how many are tried at most
PARTIAL_STEPS = 25  # steps for each start where a mesh is partial, and all are kept
FINAL_STARTS, FINAL_STEPS = 3, 25  # how many are tried to the end, and the steps for each
DOUBTFUL_STARTS = 10  # the same, of a partial mesh that fits in several places about equally
APART = 0.1  # of the smaller mesh's size: poses that differ by more are two
RIVAL = 1.12  # times the best misfit: a pose as good as that may be the right one
CLOSE = 1.25  # the same after the last round, where whole poses are not yet followed to the end
TURNED = 30.0  # degrees: poses of whole meshes that differ by more are two
NORMAL = 0.12  # of the target's size: the length that a unit normal stands for, as in a morph's first search
SELF_STEPS, AROUND = 15, 6  # of ICP of a shape with itself; neighbours that tell how dense its nodes are
SAME = 0.5  # of the distance between neighbours: what lies on itself so closely is the same shape
PLACES = 12  # parts of the whole that a partial mesh is laid on
PART_NODES = 12  # a part has at least so many nodes


class Start(NamedTuple):
    """Where an alignment starts."""

    matrix: Float  # (4, 4) the source's transform
    misfit: float  # root mean square distance that it leaves
    doubtful: bool  # whether quite another pose fits about as well
    close: tuple[Fit, ...] = ()  # of whole meshes: starts of all poses that do, if any, to be `decided`


class Frame(NamedTuple):
    """The principal frame of a set of nodes."""

    centre: Float  # (3,) their centroid
    axes: Float  # (3, 3) right-handed, in columns, the largest extent first
    radius: float  # root mean square distance from the centroid


def principal_frame(nodes: Float) -> Frame:
    """Return the principal frame of nodes (n, 3), by singular values."""
    centre = nodes.mean(axis=0)
    _, _, axes = np.linalg.svd(nodes - centre, full_matrices=False)
    axes = axes.T * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
    return Frame(centre, axes, spread_of(nodes))


def spread_of(nodes: Float) -> float:
    """Return the root mean square distance of nodes (n, 3) from their centroid."""
    return float(np.sqrt(((nodes - nodes.mean(axis=0)) ** 2).sum(axis=1).mean()))


def canonical_frame(nodes: Float) -> Float:
    """Rigid transform (4, 4) into the principal frame, axes pointing to the longer tails."""
    centre, axes, _ = principal_frame(nodes)
    tails = (((nodes - centre) @ axes) ** 3).sum(axis=0)
    signs = np.where(tails[:2] < 0, -1.0, 1.0)
    axes = axes * np.append(signs, signs.prod())
    return homogeneous(axes.T, -axes.T @ centre)


def best_start(work: Registration, own: Float, kind: str, mirror: Float) -> Start:
    """Compare the starts by one look, the best of them by ICP; return the best of all.

    Parameters
    ----------
    work : Registration
        What is to be brought together.
    own : (4, 4) float64
        The transform to the pose that the user gave: one of the starts.
    kind : {"rigid", "similarity", "affine"}
        What the alignment may do in the end.
    mirror : (4, 4) float64
        What is done to the source before: nothing, or a reflection.
    """
    whole = work.partial == "none"
    rough = dataclasses.replace(work, tolerance=SLACK * work.tolerance)
    scouts = rough.thinned(SCOUTS)
    starts, places = _starts(work, own, kind != "rigid", mirror)
    found = [Fit(starts[i], math.inf) for i in _promising(rough, starts, places)]
    # a few steps tell the hopeless ones, where both are whole
    for steps, kept in WHOLE_ROUNDS if whole else ((PARTIAL_STEPS, len(found)),):
        tried = icp(scouts, _transforms(found[:kept]), "rigid", steps)
        found = sorted(tried, key=lambda fit: fit.misfit)
    if whole:
        return _contenders(scouts, found, kind)
    doubtful = _rivalled(work, found)
    count = DOUBTFUL_STARTS if doubtful else FINAL_STARTS
    # where parts look alike only the details tell
    final = icp(rough, _transforms(found[:count]), "rigid", FINAL_STEPS)
    return Start(*min(final, key=lambda fit: fit.misfit), doubtful)


def _contenders(scouts: Registration, found: list[Fit], kind: str) -> Start:
    """Follow the best starts of whole meshes, best first, to the end; with all that come about as close."""
    tried = icp(scouts, _transforms(found[:FINAL_STARTS]), kind, FINAL_STEPS)
    best = min(range(len(tried)), key=lambda i: tried[i].misfit)
    starts = [found[best]]
    for fit in found:
        near = fit.misfit <= max(CLOSE * found[0].misfit, scouts.tolerance)
        if near and all(_turn(fit.matrix, one.matrix) > TURNED for one in starts):
            starts.append(fit)
    if len(starts) == 1:
        return Start(*tried[best], False)
    ends = [tried[best], *icp(scouts, _transforms(starts[1:]), kind, FINAL_STEPS)]
    least = min(ends, key=lambda fit: fit.misfit)
    bound = max(RIVAL * least.misfit, scouts.tolerance)
    close = [fit for fit, end in zip(starts, ends, strict=True) if end.misfit <= bound]
    return Start(*least, False, tuple(close))


def decided(work: Registration, start: Start, given: Float, kind: str) -> Start:
    """Decide between the poses of whole meshes that fit about equally well, where there are several.

    All samples do it, by position and normal together: of bones that differ much, a wrong pose may be as
    near. Each is followed to the end, for what a shear takes up does not tell poses apart. A shape that
    lies on itself when it is turned fits in several: of these the one nearest the `given` (4, 4) is taken.
    """
    if len(start.close) < 2:
        return start
    rough = dataclasses.replace(work, tolerance=SLACK * work.tolerance)
    plainer = "rigid" if kind == "rigid" else "similarity"
    starts = np.array([*_transforms(start.close), _centred(work, given, plainer)])
    plain = icp(rough, starts, plainer, FINAL_STEPS)
    ends = plain if plainer == kind else icp(rough, _transforms(plain), kind, FINAL_STEPS)
    fits = [Fit(fit.matrix, unlike(work, end.matrix, NORMAL)) for fit, end in zip(plain, ends, strict=True)]
    *found, stayed = fits  # where the given pose leads to is not asked which is best: only which of equals
    best = min(found, key=lambda fit: fit.misfit)
    bound = max(RIVAL * best.misfit, work.tolerance)
    good = [fit for fit in fits if fit.misfit <= bound and _turn(fit.matrix, best.matrix) > TURNED]
    same = [_same_shape(work, best.matrix, fit.matrix) for fit in good]
    doubtful = any(not alike and fit is not stayed for fit, alike in zip(good, same, strict=True))
    equals = [best, *itertools.compress(good, same)]
    nearest = min(equals, key=lambda fit: _turn(fit.matrix, given))
    return Start(nearest.matrix, start.misfit, doubtful)


def _centred(work: Registration, given: Float, kind: str) -> Float:
    """Shift a pose (4, 4), and scale it where the kind may, so that source and target lie in one place."""
    ours, theirs = (principal_frame(cloud.sample) for cloud in (work.source, work.target))
    return _laid(given[:3, :3] * (1.0 if kind == "rigid" else theirs.radius / ours.radius), ours, theirs)


def _laid(turn: Float, here: Frame, there: Frame) -> Float:
    """Transform (4, 4) that turns by (3, 3), which may scale, and lays one centroid on the other."""
    return homogeneous(turn, there.centre - turn @ here.centre)


def _turn(one: Float, two: Float) -> float:
    """Angle in degrees between two poses (4, 4), each a rotation and a scale."""
    here, there = one[:3, :3], two[:3, :3]
    trace = 3.0 * (here * there).sum() / (np.linalg.norm(here) * np.linalg.norm(there))
    return math.degrees(math.acos(min(max((trace - 1.0) / 2.0, -1.0), 1.0)))


def _same_shape(work: Registration, one: Float, two: Float) -> bool:
    """Whether source or target, turned from one of two poses to the other, lies on itself."""
    turns = ((work.source, inverse(one) @ two), (work.target, two @ inverse(one)))
    return any(_lies_on_itself(cloud, matrix[:3, :3]) for cloud, matrix in turns)


def _lies_on_itself(cloud: Cloud, turn: Float) -> bool:
    """Whether a shape, turned about its middle by a rotation with a scale, falls onto itself again."""
    turn = turn / np.cbrt(np.linalg.det(turn))
    scouts, nodes = cloud.thinned(SCOUTS), cloud.sample
    centre = nodes.mean(axis=0)
    start = homogeneous(turn, centre - turn @ centre)
    (fit,) = icp(Registration(scouts, scouts, "none", 0.0), start[None], "rigid", SELF_STEPS)
    count = min(AROUND + 1, len(nodes))
    spacing = float(cKDTree(nodes).query(nodes, k=count)[0][:, 1:].mean())
    back = _turn(fit.matrix, np.eye(4)) < TURNED  # it was only turned back
    return fit.misfit < SAME * spacing and not back


def _rivalled(work: Registration, fits: list[Fit]) -> bool:
    """Whether one of the fits, best first, is about as good as the first and quite another pose."""
    sample = work.source.sample
    size = min(float(np.linalg.norm(np.ptp(cloud.sample, axis=0))) for cloud in (work.source, work.target))
    best = transformed(fits[0].matrix, sample)
    rivals = [fit.matrix for fit in fits[1:] if fit.misfit < RIVAL * fits[0].misfit]
    return any(
        np.sqrt(((transformed(matrix, sample) - best) ** 2).sum(axis=1).mean()) > APART * size
        for matrix in rivals
    )


def _transforms(fits: Sequence[Fit]) -> Float:
    return np.array([fit.matrix for fit in fits])


def _promising(work: Registration, starts: list[Float], places: int) -> list[int]:
    """Which starts are worth more than a look."""
    whole = work.partial == "none"
    looks = work.thinned(SCOUTS // 2 if whole else SCOUTS)
    first = np.concatenate(
        [
            matched(looks, np.array(starts[at : at + TOGETHER])).misfit
            for at in range(0, len(starts), TOGETHER)
        ]
    )
    if whole:  # the user's pose and the four flips always get their chance
        always = list(range(min(5, len(starts))))
    else:  # and the best turn at each place
        best = [int(np.argmin(first[1 + place :: places])) for place in range(places)]
        always = [0] + [1 + place + places * turn for place, turn in enumerate(best)]
    lowest = np.argsort(first, kind="stable")[: WHOLE_STARTS if whole else PARTIAL_STARTS]
    return list(dict.fromkeys(always + lowest.tolist()))


def _starts(work: Registration, own: Float, scaled: bool, mirror: Float) -> tuple[list[Float], int]:
    """Candidate transforms, and how many places they lay the source on.

    The user's own pose first, then principal axes onto each other, turn by turn and each turn at all
    places: the whole mesh's own, or parts of it about as large as the partial mesh.
    """
    mirrored = transformed(mirror, work.source.sample)
    ours, theirs = principal_frame(mirrored), principal_frame(work.target.sample)
    whole = work.partial == "none"
    scale = theirs.radius / ours.radius if scaled and whole else 1.0
    places = [(ours, theirs)]
    if work.partial == "source":
        places += [(ours, part) for part in _parts_like(work.target.sample, ours.radius)]
    if work.partial == "target":
        places += [(part, theirs) for part in _parts_like(mirrored, theirs.radius)]
    out = [own @ mirror]
    for turn in _turns(halved=whole):
        for here, there in places:
            out.append(_laid(scale * there.axes @ turn @ here.axes.T, here, there) @ mirror)
    return out, len(places)


def _turns(halved: bool) -> list[Float]:
    """Rotations (3, 3) to try in the principal frame.

    The four flips, then the other rotations of a cube: 24; and with `halved` each of these again after
    an eighth of a turn about each axis.
    """
    cube = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            if np.linalg.det(turn) > 0:
                cube.append(turn)
    cube.sort(key=lambda turn: -np.trace(np.abs(turn)))
    if not halved:
        return cube
    eighth = [Rotation.from_rotvec(math.pi / 4 * axis).as_matrix() for axis in np.eye(3)]
    return cube + [half @ turn for half in eighth for turn in cube]


def _parts_like(nodes: Float, size: float) -> list[Frame]:
    """Frames of parts of the nodes (n, 3), around nodes far from each other, of RMS radius `size`."""
    out = []
    count = np.arange(1, len(nodes) + 1)
    chosen = int(np.argmax(((nodes - nodes.mean(axis=0)) ** 2).sum(axis=1)))
    distance = np.full(len(nodes), np.inf)
    for _ in range(PLACES):
        square = ((nodes - nodes[chosen]) ** 2).sum(axis=1)
        nearest = nodes[np.argsort(square, kind="stable")] - nodes[chosen]
        # squared radius of the 1, 2, 3 ... nearest nodes about their own centroid
        mean = np.cumsum(nearest, axis=0) / count[:, None]
        spread = np.cumsum((nearest**2).sum(axis=1)) / count - (mean**2).sum(axis=1)
        enough = int(np.searchsorted(np.maximum.accumulate(spread), size**2))
        out.append(principal_frame(nearest[: max(enough, PART_NODES)] + nodes[chosen]))
        distance = np.minimum(distance, square)
        chosen = int(np.argmax(distance))
    return out
