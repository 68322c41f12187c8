# SPDX-License-Identifier: GPL-3.0-or-later
"""The field's file: all of it comes back, and whatever is no such file is told in a line."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from femors_addon import keptfield, shapes
from femors_addon.keptfield import KeptField
from femors_addon.morph import MorphSettings, morph
from femors_addon.progress import FemorsError
from femors_addon.transforms import transformed

BALL = shapes.sphere(2)


def made(**change) -> KeptField:
    """A field that stretches a ball and moves it, of an alignment that turns it."""
    turn = np.array([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]])
    centres = transformed(turn, BALL.vertices)
    values = {
        "transform": turn,
        "centres": centres,
        "displacements": 0.1 * (centres - [5, 6, 7]),
        "faces": BALL.faces,
        "residual": np.linspace(0, 1, len(centres)),
        "spread": 0.2,
        "source": "Fémur",
        "target": "Scan",
        "date": "2026-11-25T12:00:00+00:00",
        "figures": {"median": 0.25, "said": ["a", "b"]},
    }
    return KeptField(**(values | change))


def test_a_field_comes_back_from_its_file_to_the_bit(tmp_path):
    path, field = tmp_path / "field.npz", made()
    field.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["field.npz"]
    back = keptfield.load(path)
    for name in ("transform", "centres", "displacements", "faces", "residual"):
        assert np.array_equal(getattr(back, name), getattr(field, name)), name
        assert getattr(back, name).dtype == (np.int32 if name == "faces" else np.float64)
    for name in ("spread", "source", "target", "date", "figures"):
        assert getattr(back, name) == getattr(field, name), name
    assert back.name == "Fémur to Scan"
    assert back.encoded() == field.encoded()


def test_the_layout_is_that_of_the_documentation(tmp_path):
    made().save(tmp_path / "f.npz")
    with np.load(tmp_path / "f.npz", allow_pickle=False) as arrays:
        assert int(arrays["layout"]) == keptfield.LAYOUT == 2
        listed = [
            "transform",
            "centres",
            "displacements",
            "faces",
            "residual",
            "spread",
            "source",
            "target",
            "date",
            "figures",
        ]
        assert sorted(arrays.files) == sorted(["layout", *listed])
    words = (Path(keptfield.__file__).parents[1] / "docs" / "landmarks.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in words for name in listed)


def test_a_morph_keeps_its_field(tmp_path):
    goal = BALL.moved(BALL.vertices * [1.2, 1.0, 0.9])
    result = morph(BALL, goal, MorphSettings(alignment="rigid"))
    result.save_field(tmp_path / "f.npz", "a", "b", "2026-01-01")
    field = keptfield.load(tmp_path / "f.npz")
    assert (field.source, field.target, field.date) == ("a", "b", "2026-01-01")
    assert np.allclose(field.morphed.vertices, result.vertices, atol=1e-12)
    assert np.allclose(field.origin.vertices, BALL.vertices, atol=1e-12)
    assert field.figures["target_to_surface"] == result.after.target_to_surface.as_dict()


def test_layout_1_is_still_read(tmp_path):
    field = made()
    np.savez(
        tmp_path / "old.npz",
        layout=1,
        transform=field.transform,
        centres=field.centres,
        displacements=field.displacements,
        spread=0.2,
    )
    back = keptfield.load(tmp_path / "old.npz")
    assert np.array_equal(back.centres, field.centres)
    assert len(back.faces) == 0 and np.isnan(back.residual).all()


def test_placed_is_the_same_map_in_other_coordinates():
    field = made()
    matrix = np.array([[0.0, 0, 1, 1], [1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]])
    there = field.placed(matrix)
    assert np.allclose(there.origin.vertices, transformed(matrix, field.origin.vertices))
    assert np.allclose(there.morphed.vertices, transformed(matrix, field.morphed.vertices))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"layout": 99}, "newer FEMORS .layout 99"),
        ({"layout": np.arange(3)}, "another kind"),
        ({"layout": "two"}, "another kind"),
        ({"transform": np.eye(3)}, "4 x 4|another kind"),
        ({"transform": np.full((4, 4), np.nan)}, "finite"),
        ({"transform": np.diag([1.0, 1, 0, 1])}, "flattens"),
        ({"spread": -1.0}, "positive"),
        ({"spread": np.ones(2)}, "another kind"),
        ({"centres": np.zeros((2, 2))}, "another kind|not as many"),
        ({"centres": "text"}, "another kind"),
        ({"displacements": None}, "displacements is missing"),
        ({"faces": np.array([[0, 1, 9999]])}, "not there"),
        ({"figures": "[1"}, "another kind"),
    ],
)
def test_a_file_of_other_content_is_told(tmp_path, change, words):
    with np.load(io.BytesIO(made().encoded())) as held:
        arrays = dict(held) | change
    path = tmp_path / "field.npz"
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(FemorsError, match=words) as error:
        keptfield.load(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def contents() -> dict[str, bytes]:
    """What might stand in a file that should hold a field, but does not."""
    whole = made().encoded()
    hurt = bytearray(whole)
    hurt[200:260] = b"x" * 60
    array, pickled = io.BytesIO(), io.BytesIO()
    np.save(array, np.zeros(3))
    np.savez(pickled, layout=np.array([{}, None]))
    return {
        "text": b"hello",
        "a start only": whole[:40],
        "cut in half": whole[: len(whole) // 2],
        "cut at its end": whole[:-30],
        "damaged": bytes(hurt),
        "a single array": array.getvalue(),
        "objects": pickled.getvalue(),
        "an empty archive": b"PK\x05\x06" + bytes(18),
    }


@pytest.mark.parametrize("content", contents().values(), ids=contents())
def test_what_is_no_field_is_told(tmp_path, content):
    path = tmp_path / "field.npz"
    path.write_bytes(content)
    with pytest.raises(FemorsError, match=r"field\.npz: is not a field file") as error:
        keptfield.load(path)
    assert "\n" not in str(error.value)


def test_a_field_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(FemorsError, match=r"none\.npz"):
        keptfield.load(tmp_path / "none.npz")
    with pytest.raises(FemorsError, match="folder"):
        keptfield.load(tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"layout": np.array(0)}, "layout 0"),
        ({"layout": np.array(-1)}, "layout -1"),
        ({"faces": shapes.sphere(1).faces + 0.5}, "whole numbers"),
        ({"transform": np.vstack((np.eye(4)[:3], [0, 0, 1, 1]))}, "not affine"),
    ],
)
def test_arrays_of_another_kind_are_refused(tmp_path, change, words):
    ball = shapes.sphere(1)
    good = KeptField(np.eye(4), ball.vertices, ball.vertices, ball.faces, np.zeros(len(ball.vertices)), 0.1)
    good.save(tmp_path / "f.npz")
    with np.load(tmp_path / "f.npz") as arrays:
        np.savez(tmp_path / "g.npz", **(dict(arrays) | change))
    with pytest.raises(FemorsError, match=words):
        keptfield.load(tmp_path / "g.npz")
