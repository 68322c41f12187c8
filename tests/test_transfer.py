# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole geometries by a field."""

from __future__ import annotations

import numpy as np
import pytest
from fieldcases import BONE, CARRIER, SHIFT, TARGET, site, slab

from femors_addon.carry import Carrier
from femors_addon.keptfield import KeptField
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import FemorsError
from femors_addon.transfer import Transfer
from femors_addon.transfer_settings import TransferSettings
from femors_addon.transforms import transformed
from femors_addon.volume_quality import scaled_jacobians


# --- surfaces -------------------------------------------------------------------------------------
def test_a_patch_lands_on_the_target_and_projected_exactly():
    patch = site(0.5)
    plain = Transfer(CARRIER, TransferSettings()).points(patch.vertices)
    assert plain.notes == plain.faults == ()
    assert SurfaceIndex(TARGET).signed(plain.points) == pytest.approx(0.5, abs=0.02)
    laid = Transfer(CARRIER, TransferSettings(), TARGET).points(patch.vertices)
    assert np.abs(SurfaceIndex(TARGET).closest(laid.points).distance).max() < 1e-9
    assert laid.projected == pytest.approx(np.linalg.norm(laid.points - plain.points, axis=1))
    assert "projected by 0.49" in laid.summary()


def test_inside_stays_inside_and_outside_out():
    """Random points near a bone that is bent: none changes its side."""
    rng = np.random.default_rng(0)
    points = BONE.vertices[rng.integers(0, len(BONE.vertices), 2000)] + rng.normal(size=(2000, 3)) * 4.0
    before = SurfaceIndex(BONE).signed(points)
    got = Transfer(CARRIER, TransferSettings()).points(points)
    after = SurfaceIndex(TARGET).signed(got.points)
    clear = np.abs(before) > 1e-3
    assert (np.sign(after[clear]) == np.sign(before[clear])).all()


def test_inverse_and_strength_of_things():
    patch = site(2.0).vertices
    there = Transfer(CARRIER, TransferSettings()).points(patch).points
    back = Transfer(CARRIER, TransferSettings(inverse=True)).points(there)
    assert np.abs(back.points - patch).max() < 1e-3
    assert "error of the inverse" in back.summary()
    half = Transfer(CARRIER, TransferSettings(strength=0.5)).points(patch)
    assert half.points == pytest.approx((patch + there) / 2)


# --- solids ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("project", [False, True])
def test_cartilage_keeps_its_thickness_and_its_elements(project):
    mesh = slab()
    assert (scaled_jacobians(mesh) > 0).all()
    transfer = Transfer(CARRIER, TransferSettings(), TARGET if project else None)
    got = transfer.mesh(mesh)
    assert (scaled_jacobians(mesh.moved(got.points)) > 0).all()
    off = SurfaceIndex(TARGET).signed(got.points)
    half = len(off) // 2
    assert np.abs(off[:half]).max() < (1e-6 if project else 0.01)
    assert off[half:].min() > 2.5 and off[half:].max() < 3.5


def test_nodes_outside_are_put_back_outside_a_target_that_is_farther_out():
    """Without that, the nodes 3 mm off the bone would end 2 mm inside a target that is 5 mm larger."""
    mesh = slab()
    larger = TARGET.moved(TARGET.vertices + 5.0 * TARGET.vertex_normals)
    got = Transfer(CARRIER, TransferSettings(), larger).mesh(mesh)
    half = len(mesh.nodes) // 2
    assert got.kept > 0.9 * half and "put back" in got.summary()
    off = SurfaceIndex(larger).signed(got.points)[half:]
    assert np.percentile(off, 5) > 1.0 and np.median(off) == pytest.approx(3.0, abs=0.3)


def test_a_field_that_mirrors_refuses_solids():
    mirror = np.diag([-1.0, 1, 1, 1])
    centres = transformed(mirror, BONE.vertices)
    flipped = KeptField(
        mirror, centres, np.zeros_like(centres), BONE.faces[:, ::-1], np.zeros(len(centres)), 3.0
    )
    with pytest.raises(FemorsError, match="inside out"):
        Transfer(Carrier(flipped), TransferSettings()).mesh(slab())
    points = site(2.0).vertices
    got = Transfer(Carrier(flipped), TransferSettings()).points(points)
    assert got.points == pytest.approx(points * [-1, 1, 1], abs=1e-6)


# --- words ----------------------------------------------------------------------------------------
def test_what_is_on_the_target_already_is_told():
    there = Transfer(CARRIER, TransferSettings()).points(site().vertices).points
    again = Transfer(CARRIER, TransferSettings()).points(there)
    assert any("already" in fault for fault in again.faults)
    assert Transfer(CARRIER, TransferSettings(inverse=True)).points(there).faults == ()
    back = Transfer(CARRIER, TransferSettings(inverse=True)).points(site().vertices)
    assert any("lies on the source already" in fault for fault in back.faults)


def test_what_is_far_is_told_with_its_distance():
    far = site().vertices - [0.0, 80.0, 0.0]
    got = Transfer(CARRIER, TransferSettings()).points(far)
    assert any("from the source's surface" in note for note in got.notes) and not got.faults
    away = Transfer(CARRIER, TransferSettings()).points(far - [0.0, 5e3, 0.0])
    assert any("another object" in fault for fault in away.faults)
    assert away.points == pytest.approx(transformed(SHIFT, far - [0.0, 5e3, 0.0]))


def test_points_in_metres_and_a_foreign_surface_are_remarked():
    rows = BONE.vertices[[10, 400, 900, 1200]]
    transfer = Transfer(CARRIER, TransferSettings())
    assert transfer.points(rows).notes == ()
    small = transfer.points(rows / 1000.0 + [0.0, 3.0, 200.0])
    assert any("metres" in note for note in small.notes)
    assert transfer.points(BONE.corners[5]).notes == ()  # a small site on the bone
    other = TARGET.moved(TARGET.vertices + [0.0, 40.0, 0.0])
    laid = Transfer(CARRIER, TransferSettings(), other).points(rows)
    assert any("is it the right one" in note for note in laid.notes)
    assert Transfer(CARRIER, TransferSettings(), TARGET).points(rows).notes == ()


def test_what_cannot_be_is_refused():
    with pytest.raises(FemorsError, match="strength 1"):
        Transfer(CARRIER, TransferSettings(strength=0.5), TARGET)
    with pytest.raises(FemorsError, match="Strength"):
        Transfer(CARRIER, TransferSettings(strength=2.0))
    with pytest.raises(FemorsError, match="no points"):
        Transfer(CARRIER, TransferSettings()).points(np.empty((0, 3)))
