# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a transfer: what was carried is seen, and each landmark that is seen has its name beside it."""

from __future__ import annotations

import base64
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from pngs import pixels
from solids import sphere

from femors_addon import callouts, report_html, report_transfer
from femors_addon.picture import HEIGHT, png
from femors_addon.report_transfer import Carried, dots, transfer_figures
from femors_addon.shapes import pair
from femors_addon.transfer import Transferred

NONE = np.zeros(0)


def inside(drawn: str) -> bytes:
    """Return the PNG in a picture with names."""
    return base64.b64decode(re.search(r"data:image/png;base64,([^\"]+)", drawn)[1])


def ends(drawn: str) -> dict[str, tuple[float, float, float, float]]:
    """Return for each name where its line starts and ends, in pixels of the whole."""
    lines = re.findall(r'd="M([\d.]+) (-?[\d.]+)L([\d.]+) ([\d.]+)"', drawn)
    root = ElementTree.fromstring(drawn)
    names = [one.text for one in root.iter() if one.tag.endswith("text")]
    return dict(zip(names, [tuple(map(float, line)) for line in lines], strict=True))


def landmarks(points: np.ndarray, names: tuple[str, ...]) -> Carried:
    return Carried("m", points, Transferred(points, np.ones(len(points)), NONE, NONE), NONE, names)


def test_a_transfers_pictures_have_landmarks_things_and_regions():
    bone = pair(600, 600).source
    marks = landmarks((bone.vertices.max(axis=0) + 5.0)[None], ("far",))
    moved = Transferred(bone.vertices, NONE, NONE, NONE)
    patch = Carried("p", bone.vertices + 2.0, moved, NONE, (), bone.faces)

    def seen(carried, regions=(None, None)):
        (section, *_) = transfer_figures(bone, bone, carried, regions=regions)
        shown = [one.content for one in section.items if isinstance(one, report_html.Figure)]
        assert len(shown) == 4
        return [pixels(data if isinstance(data, bytes) else inside(data)).astype(int) for data in shown]

    def count(picture, one, others):
        return int((picture[..., one] > 30 + np.max(picture[..., others], axis=-1)).sum())

    plain, marked = seen([]), seen([marks])
    assert all(count(picture, 0, [1, 2]) == 0 for picture in plain)
    assert all(count(picture, 0, [1, 2]) > 20 for picture in marked), "a red dot in each"
    carried = seen([patch])
    assert all(count(picture, 1, [0, 2]) > 200 for picture in carried), "what is carried is green"
    painted = seen([], (None, (bone.vertices[:, 2] > bone.vertices[:, 2].mean()).astype(float)))
    greens = [count(picture, 1, [0, 2]) for picture in painted]
    assert greens[:2] == [0, 0] and min(greens[2:]) > 200, "a region after, none before"


def test_a_line_leads_from_each_name_to_its_dot_and_what_is_hidden_has_none():
    ball = sphere(3)
    egg = ball.moved(ball.vertices * [1.0, 1.2, 1.8])
    points = np.array([[0, 0, 18.0], [0, 0, -18.0], [0, 0, 0]])
    (section, *_) = transfer_figures(egg, None, [landmarks(points, ("top", 'a < b & "c"', "within"))])
    shown = [one.content for one in section.items if isinstance(one, report_html.Figure)]
    assert len(shown) == 2
    for drawn in shown:
        lines, seen = ends(drawn), pixels(inside(drawn)).astype(int)
        assert set(lines) == {"top", 'a < b & "c"'}
        before = float(re.search(r'<image x="([\d.]+)"', drawn)[1])
        for *_, across, down in lines.values():
            red, green, blue = seen[int(down), int(across - before)]
            assert red > 60 + max(green, blue)


def test_more_names_than_fit_are_left_out(monkeypatch):
    bone = pair(600, 600).source
    monkeypatch.setattr(report_transfer, "NAMED", 1)
    (section, *_) = transfer_figures(bone, None, [landmarks(bone.vertices[:300:100], ("a", "b", "c"))])
    assert all(isinstance(one.content, bytes) for one in section.items if hasattr(one, "content"))


@pytest.mark.parametrize("count", [1, 12, 30])
def test_names_stand_a_line_apart_on_the_side_that_is_nearer(count):
    data = png(np.full((200, 80, 3), 255, np.uint8))
    rng = np.random.default_rng(count)
    names = [(80 * rng.random(), 200 * rng.random() ** 3, f"name {k}") for k in range(count)]
    drawn = callouts.named(data, names, "words")
    assert inside(drawn) == data
    lines = ends(drawn)
    assert set(lines) == {name for *_, name in names}
    for left in (True, False):
        side = [one for one in names if (one[0] < 40) == left]
        levels = sorted(lines[name][1] for *_, name in side)
        assert np.all(np.diff(levels) >= callouts.LINE - 0.11)
        if len(side) * callouts.LINE < 200:
            assert all(0 < level < 200 for level in levels)
        assert all((lines[name][0] < lines[name][2]) == left for *_, name in side)


def test_names_are_cut_where_they_are_longer_than_there_is_room_for():
    data = png(np.full((60, 80, 3), 255, np.uint8))
    drawn = callouts.named(data, [(10.0, 30.0, "w" * 600)], "words")
    (name,) = ends(drawn)
    assert name == "w" * (callouts.LONGEST - 1) + "…"
    width = float(re.search(r'viewBox="0 0 (\d+)', drawn)[1])
    assert 80 + 30 * 8 < width < 500


def test_as_many_names_as_are_drawn_fit_on_one_side():
    assert report_transfer.NAMED * callouts.LINE < HEIGHT


def test_balls_of_landmarks():
    assert len(dots(np.zeros((3, 3)), 1.0).vertices) == 3 * 42
