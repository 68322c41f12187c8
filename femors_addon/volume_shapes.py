# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes of solid elements after a morph: give back what they lost, as far as the surface allows."""

from __future__ import annotations

import numpy as np

from .features import FeatureLines
from .mesh import Float, Int
from .nearest import SurfaceIndex
from .progress import Progress
from .volume import Block, VolumeMesh, carry_mid_nodes
from .volume_quality import jacobians_of, scaled_jacobians

RESHAPE_ROUNDS = 30
KEPT_SHARE = 0.9  # of its scaled Jacobian: an element that has less is given back its shape
SHAPE_STEP = 0.5
TUNE_ROUNDS = 40
TUNED = 30  # elements that are tuned at a time, the worst ones
NUDGE = 1e-5  # of the mean edge: step of the finite differences
STRIDES = (0.2, 0.05, 0.0125, 0.003)  # of the mean edge: steps that are tried


class _Holder:
    """Where nodes may go: inside freely, on the surface along the target, on a rim along its rim."""

    def __init__(self, mesh: VolumeMesh, goal: Float, at: Int, target: SurfaceIndex | None) -> None:
        self._mesh, self._goal, self._at, self._target = mesh, goal, at, target
        if target is not None:
            self._lines = FeatureLines.between(mesh.surface()[0], target.surface)

    def __call__(self, nodes: Float, before: Float) -> Float:
        """Bring moved surface nodes (n, 3) back to where they may be; those not moved stay."""
        at = self._at
        if self._target is None:
            nodes[at] = self._goal[at]
        else:
            moved = at[np.any(nodes[at] != before[at], axis=1)]
            if len(moved):
                nodes[moved] = self._target.closest(nodes[moved]).point
                rim, points = self._lines.onto(nodes[at])
                mine = np.isin(at[rim], moved)
                nodes[at[rim[mine]]] = points[mine]
        return carry_mid_nodes(self._mesh, nodes)


def reshaped(
    mesh: VolumeMesh, goal: Float, at: Int, jacobian: Float, target: SurfaceIndex | None, progress: Progress
) -> Float:
    """Give elements whose scaled Jacobian fell the shape that they had.

    First each asks its nodes to where the best similarity of its source shape has them; then the worst
    ones are tuned by descent on what they lack. Nodes on the surface slide along the target.

    Parameters
    ----------
    mesh : VolumeMesh
        The source.
    goal : (n, 3) float64
        Where the morph has its nodes.
    at : (s,) int32
        Nodes on the surface.
    jacobian : (e,) float64
        Scaled Jacobians of the source; elements that are inverted there are left alone.
    target : SurfaceIndex or None
        None keeps surface nodes where they are.

    Returns
    -------
    nodes : (n, 3) float64
        The best state met, by the smallest scaled Jacobian of all and the worst ratio of one to what it was.
    """
    held = _Holder(mesh, goal, at, target)
    judge = _Judge(mesh, jacobian)
    for number in range(RESHAPE_ROUNDS + 1):
        progress(0.5 * number / RESHAPE_ROUNDS, f"volume: element shapes, round {number + 1}")
        ratio = judge(goal)
        poor = np.flatnonzero(ratio < KEPT_SHARE)
        if not len(poor) or number == RESHAPE_ROUNDS:
            break
        weight = np.maximum(ratio[poor], 0.1) ** -3 - 1.0
        goal = held(goal + _shape_moves(mesh, goal, poor, weight), goal)
    return _tuned(mesh, judge, held, progress)


class _Judge:
    """Scaled Jacobians as shares of the source's, and the best state met."""

    def __init__(self, mesh: VolumeMesh, jacobian: Float) -> None:
        self._mesh, self._valid = mesh, jacobian > 0
        self.reference = np.where(self._valid, jacobian, 1.0)
        self._lowest = float(jacobian[self._valid].min(initial=1.0))
        self.best: Float = mesh.nodes
        self.score = -np.inf

    def __call__(self, nodes: Float) -> Float:
        """Return the ratio (e,) of each valid element, infinity for the others; remember the best nodes."""
        now = scaled_jacobians(self._mesh.moved(nodes))
        ratio = np.where(self._valid, now / self.reference, np.inf)
        least = float(now[self._valid].min(initial=1.0)) / self._lowest
        score = min(least, 1.5 * float(ratio.min(initial=np.inf)))
        if score > self.score:
            self.best, self.score = nodes, score
        return ratio


def _tuned(mesh: VolumeMesh, judge: _Judge, held: _Holder, progress: Progress) -> Float:
    """Move the nodes of the worst elements down the gradient of what these and their neighbours lack."""
    nodes = judge.best
    edge = mesh.surface()[0].mean_edge
    stride = 0
    for number in range(TUNE_ROUNDS):
        progress(0.5 + 0.5 * number / TUNE_ROUNDS, f"volume: worst elements, round {number + 1}")
        ratio = judge(nodes)
        worst = np.argsort(ratio, kind="stable")[:TUNED]
        worst = worst[ratio[worst] < KEPT_SHARE]
        if not len(worst) or stride == len(STRIDES):
            break
        slope = _slope(mesh, nodes, worst, judge.reference, NUDGE * edge)
        length = np.linalg.norm(slope, axis=1).max()
        if not length > 0:
            break
        before = judge.score
        trial = held(nodes - STRIDES[stride] * edge * slope / length, nodes)
        judge(trial)
        if judge.score > before:
            nodes = trial
        else:
            nodes, stride = judge.best, stride + 1
    return judge.best


def _slope(mesh: VolumeMesh, nodes: Float, worst: Int, reference: Float, nudge: float) -> Float:
    """Gradient (n, 3), at the corners of the worst elements, of the sum of squares of what elements lack."""
    out = np.zeros_like(nodes)
    touched = np.zeros(len(nodes), dtype=bool)
    for block, start in mesh.with_starts():
        mine = worst[(worst >= start) & (worst < start + len(block))] - start
        touched[block.nodes[mine, : block.shape.corners]] = True
    for block, start in mesh.with_starts():
        if block.shape.solid:
            _add_slopes(out, block, nodes, touched, reference[start : start + len(block)], nudge)
    return out


def _add_slopes(
    out: Float, block: Block, nodes: Float, touched: np.ndarray, reference: Float, nudge: float
) -> None:
    corners = block.nodes[:, : block.shape.corners]
    element, corner = np.nonzero(touched[corners])
    if not len(element):
        return
    positions = np.ascontiguousarray(nodes[corners[element]].transpose(1, 2, 0))
    rows = np.arange(len(element))
    for axis in range(3):
        lacks = []
        for sign in (1.0, -1.0):
            positions[corner, axis, rows] += sign * nudge
            share = jacobians_of(positions, block.shape) / reference[element]
            positions[corner, axis, rows] -= sign * nudge
            lacks.append(np.maximum(1.0 - share, 0.0) ** 4)
        change = (lacks[0] - lacks[1]) / (2.0 * nudge)
        out[:, axis] += np.bincount(corners[element, corner], change, minlength=len(out))


def _shape_moves(mesh: VolumeMesh, nodes: Float, elements: Int, weight: Float) -> Float:
    """Moves (n, 3) of the nodes of some elements towards the similarity images of their source shapes."""
    total, shared = np.zeros_like(nodes), np.zeros(len(nodes))
    for block, start in mesh.with_starts():
        mine = (elements >= start) & (elements < start + len(block)) & block.shape.solid
        corners = block.nodes[elements[mine] - start, : block.shape.corners]
        rest, here = mesh.nodes[corners], nodes[corners]
        rest = rest - rest.mean(axis=1, keepdims=True)
        offset = here - here.mean(axis=1, keepdims=True)
        u, size, vt = np.linalg.svd(np.einsum("eki,ekj->eij", offset, rest))
        sign = np.ones((len(corners), 3))
        sign[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
        turn = np.einsum("eij,ej,ejk->eik", u, sign, vt)
        square = np.maximum(np.einsum("eki,eki->e", rest, rest), 1e-300)
        scale = np.maximum((size * sign).sum(axis=1) / square, 0.0)
        wanted = scale[:, None, None] * np.einsum("eij,ekj->eki", turn, rest) - offset
        load = np.repeat(weight[mine], corners.shape[1])
        np.add.at(shared, corners.ravel(), load)
        np.add.at(total, corners.ravel(), wanted.reshape(-1, 3) * load[:, None])
    return SHAPE_STEP * total / np.maximum(shared, 1e-300)[:, None]
