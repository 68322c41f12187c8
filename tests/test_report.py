# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports: pages that need nothing else, data that says the same, pictures that show what is there."""

from __future__ import annotations

import csv
import dataclasses
import html.parser
import io
import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from pngs import pixels
from solids import sphere

from femors_addon import picture, plots, report_files, report_html, report_tables
from femors_addon.bodies import Body
from femors_addon.cleaning import MERGED, clean
from femors_addon.mesh import Surface
from femors_addon.morph import morph
from femors_addon.overclosure_result import Step
from femors_addon.progress import FemorsError
from femors_addon.report_figures import mesh_figures, morph_figures
from femors_addon.report_html import Figure
from femors_addon.report_overclosure import overclosure_figures
from femors_addon.shapes import pair
from femors_addon.transforms import transformed
from femors_addon.triples import placed


class Page(html.parser.HTMLParser):
    """What is on a page, and what it asks of others."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.links, self.count, self.text = [], [], {}, []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.count[tag] = self.count.get(tag, 0) + 1
        self.links += [v for k, v in attributes if k in ("src", "href") and not v.startswith("data:")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.count[tag] = self.count.get(tag, 0) + 1

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def morphed():
    bones = pair(1200, 1300, posed=True)
    return bones, morph(bones.source, bones.target)


def page_of(morphed) -> str:
    bones, result = morphed
    source = bones.source
    aligned = source.moved(transformed(result.transform, source.vertices))
    values = {"displacement": result.displacement, "surface_distance": result.surface_distance}

    def figures():
        return morph_figures(aligned, source.moved(result.vertices), bones.target, values, "mm")

    return report_files.report_bytes("r.html", result.report(), "A <morph>", figures).decode()


def test_a_page_needs_nothing_else_and_says_everything(morphed):
    text = page_of(morphed)
    page = Page(text)
    assert not page.open, "a tag is not closed"
    assert not page.links and "<script" not in text and "url(" not in text
    assert page.count["img"] >= 10 and page.count["svg"] >= 7 and page.count["table"] >= 4
    words = " ".join(page.text)
    for expected in (
        "A <morph>",
        morphed[1].stop_reason,
        "Aspect ratio",
        "Convergence",
        "Normal weight",
        "SciPy",
        "CPU time (s)",
        "Displacement (mm)",
    ):
        assert expected in words, expected


def test_json_and_csv_have_the_same_figures(morphed):
    report = morphed[1].report()
    data = json.loads(report_files.report_bytes("r.json", report, ""))
    assert data == json.loads(json.dumps(report))
    rows = dict(csv.reader(io.StringIO(report_files.report_bytes("r.CSV", report, "").decode())))
    assert rows["name"] == "value"
    assert float(rows["after.aspect.median"]) == report["after"]["aspect"]["median"]
    assert rows["history.0.level"] == report["history"][0]["level"]
    with pytest.raises(FemorsError, match=r"a report ends in \.html"):
        report_files.report_bytes("r.pdf", report, "")


def test_any_report_becomes_tables():
    """Keys that nobody has heard of, such as those of jobs to come."""
    stat = {"median": 1.0, "p01": 0.0, "p99": 2.0, "maximum": 3.0}
    report = {
        "pairs": [{"bodies": "a, b", "depth": 0.5}, {"bodies": "b, c", "depth": 0.25, "more": True}],
        "left": {"before": {"gap": stat, "count": 7}, "after": {"gap": stat, "count": 0}},
        "bodies": [{"name": "a", "aspect": {"before": stat, "after": stat}, "odd": {"k": 2}}],
        "deep": {"er": {"still": 3}},
        "warnings": ["look & see"],
        "matrix": [[1.0, 0.0], [0.0, 1.0]],
        "long": list(range(100)),
        "nothing": None,
        "none": [],
    }
    found = report_tables.sections(report)
    assert [section.title for section in found] == [
        "Summary",
        "Pairs",
        "Left",
        "Bodies",
        "Deep",
        "Matrix",
        "Long",
    ]
    page = report_html.html("t", "", found)
    assert "look &amp; see" in page and "100 in all" in page
    assert "1 [0, 2] 3 \u2192 1 [0, 2] 3" in page and "K: 2" in page and "{" not in page.split("</style>")[1]
    assert "<th>Gap</th><td" in page and "1 [0, 2] 3" in page and "<th>Still</th>" in page
    assert not Page(page).open


def test_a_table_says_what_statistics_are_only_where_it_has_some():
    stat = {"median": 1.0, "p01": 0.0, "p99": 2.0, "maximum": 3.0}
    plain = {"volume": 2.0, "inverted": 1}
    assert report_tables.compared(plain, plain).head == ("", "before", "after")
    mixed = {**plain, "gap": stat}
    assert report_tables.compared(mixed, mixed).head == (report_tables.STATISTICS, "before", "after")


def test_a_removals_convergence_has_plots_of_its_own():
    """Lengths and counts are not on one axis, the iteration is no curve, and each curve has its key."""
    counts_of = (0, 0, 40, 10, 0, 0)  # not counted yet in the first two
    steps = [Step(i + 1, 0.5**i, count, 2.0 - 0.1 * i) for i, count in enumerate(counts_of)]
    report = {"history": [dataclasses.asdict(step) for step in steps], "solve_cpu_seconds": 3.25}
    for nested in (report, {"overclosure": report}):
        sections = report_tables.sections(nested)
        items = sections[-1].items
        lengths, counts = (one.content for one in items if isinstance(one, report_html.Figure))
        assert ">Depth left</text>" in lengths and ">Spread</text>" in lengths
        assert lengths.count("<polyline") == 2 and counts.count("<polyline") == 1
        assert lengths.count("<circle") == 12 and counts.count("<circle") == 4, "a count of 0 is shown"
        assert "Number" not in lengths and "ressing" not in lengths
        page = report_html.html("t", "", sections)
        assert "coarsest" not in page and "all levels" not in page and "Pierced" not in page
        assert "CPU time of the removal (s)" in page
        rows = page[page.index("<details>") : page.index("</details>")]
        for head in ("Iteration", "Depth left", "Edges crossing", "Spread"):
            assert f"<th>{head}</th>" in rows
        assert not Page(page).open
        table = items[-1]
        column = table.head.index("Edges crossing")
        assert [row[column] for row in table.rows] == ["", "", "40", "10", "0", "0"], "not counted is not 0"


def test_edges_that_were_never_counted_have_no_plot():
    report = {"history": [dataclasses.asdict(Step(1, 0.5, 0, 2.0))]}
    items = report_tables.sections(report)[0].items
    assert [type(one).__name__ for one in items] == ["Figure", "str", "Table"]
    assert items[1].startswith("Edges crossing: none")
    assert items[2].head == ("Iteration", "Depth left", "Spread"), "0 of what was not counted"


def test_a_page_has_base_names_and_notes_apart_from_warnings():
    vertices, faces = soup()
    faces = np.concatenate((faces, [[0, 1, len(vertices)]]))  # beside a soup, a face that shares two vertices
    twice = clean(np.concatenate((vertices, vertices[2:3] + 1.0)), faces, "mesh")
    merged = next(note.partition(": ")[2] for note in twice.notes if note.endswith(MERGED))
    report = {
        "femors": "1.2",
        "files": {"source": "/far/away/a.stl", "out": "/x/a.stl", "target": "/far/b.stl", "field": None},
        "warnings": [f"/far/b.stl: {merged}", "/far/b.stl: is odd"],
    }
    kept = json.dumps(report)
    page = report_html.html("t", "", report_tables.sections(report))
    assert json.dumps(report) == kept
    assert "FEMORS version" in page and "Femors" not in page
    assert ">b.stl</td>" in page and ">/far/away/a.stl</td>" in page, (
        "two files of one name keep their folders"
    )
    assert '<ul class="warn"><li>b.stl: is odd</li></ul>' in page
    assert f'<ul class="note"><li>b.stl: {merged}</li></ul>' in page


def soup():
    ball = pair(100, 100).source
    return ball.vertices[ball.faces.ravel()], np.arange(ball.faces.size).reshape(-1, 3)


def test_lengths_without_a_unit_say_whose_they_are():
    ball = pair(200, 200).source
    values = {"displacement": ball.vertices[:, 0] - ball.vertices[:, 0].min()}
    for unit, words in (("", "(in the unit of the meshes)"), ("mm", "(mm)")):
        page = report_html.html("t", "", mesh_figures(ball, None, values, unit))
        assert page.count(f">Displacement {words}</text>") == 2, "the legend and the histogram"


def test_a_view_turns_to_what_is_to_be_seen():
    ball = pair(100, 100).source
    for sight in picture.views([ball]):
        for side in (1.0, -1.0):
            spot = sight.centre + side * sight.towards[None]
            seen = picture.facing(sight, [spot])
            assert ((spot - seen.centre) @ seen.towards).item() > 0
            assert np.linalg.det([seen.right, seen.up, seen.towards]) > 0


def test_a_legend_stays_within_its_plot():
    names = [f"series {i}" for i in range(4)]
    drawn = plots.curves({name: [(1, 1.0), (2, 2.0)] for name in names}, "x", "y")
    places = [float(re.search(rf'x="([^"]+)" y="17">{name}<', drawn)[1]) for name in names]
    assert max(places) < plots.WIDTH - 80


def square(depth: float, half: float) -> Surface:
    corners = [[-half, -half, depth], [half, -half, depth], [half, half, depth], [-half, half, depth]]
    return Surface(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]))


def test_the_nearer_surface_is_seen():
    axes = np.eye(3)
    view = picture.View(axes[0], axes[1], axes[2], np.zeros(3), 1.0, 1.0)
    near, far = picture.Shown(square(1.0, 0.3), (1, 0, 0)), picture.Shown(square(0.0, 0.7), (0, 0, 1))
    for shown in ([near, far], [far, near]):
        seen = pixels(picture.picture(shown, view, 100)).astype(int)
        assert seen.shape == (100, 100, 3)
        assert (seen[2, 2] == 255).all(), "the ground is white"
        assert seen[50, 50, 0] > 150 > 50 > seen[50, 50, 2]
        assert seen[50, 20, 2] > 150 > 50 > seen[50, 20, 0]
        red = (seen[..., 0] > 100) & (seen[..., 2] < 50)
        assert red.sum() == pytest.approx(30 * 30, rel=0.08)


def test_the_whole_mesh_is_in_the_picture():
    bone = pair(800, 800, posed=True).source
    for view in picture.views([bone]):
        seen = pixels(picture.picture([picture.Shown(bone)], view, 200))
        ink = (seen < 250).any(axis=2)
        assert ink.any() and not ink[[0, -1]].any() and not ink[:, [0, -1]].any()
        rows = np.flatnonzero(ink.any(axis=1))
        assert len(rows) > 170, "it fills the picture"


def test_each_shape_is_drawn_once_in_a_view_whatever_it_shows(monkeypatch):
    """Displacement and gap of a moved body are two colourings of one drawing."""
    drawn = []
    fragments = picture.fragments
    monkeypatch.setattr(picture, "fragments", lambda *args: drawn.append(1) or fragments(*args))
    bodies = [Body("one", sphere(2)), Body("two", sphere(2, centre=(19.0, 0.5, 0.3)))]
    after = {body.name: body.nodes + [0.5 * number, 0, 0] for number, body in enumerate(bodies)}
    pictures, _ = overclosure_figures(bodies, after, 1.0)
    shown = [item for item in pictures.items if isinstance(item, Figure) and isinstance(item.content, bytes)]
    together, alone = 2 * 2, 2 * 2 * 2  # states and views, of both bodies; bodies, states and views
    assert len(drawn) == 2 * together + alone
    assert len(shown) == together + alone + 2  # and how far the second was moved


def test_plots_are_sound_svg():
    sample = np.random.default_rng(0).gamma(2.0, 1.0, 500)
    for drawn in (
        plots.histogram({"a < b": sample, "b": 2 * sample}, "length & more"),
        plots.histogram({"": np.full(10, 3.0)}, "constant"),
        plots.histogram({"": [-1.0, 0.0, 1.0]}, "signed"),
        plots.curves({"rms": [(i, 0.5**i) for i in range(12)], "zero": [(1, 0.0)]}, "i", "mm"),
        plots.curves({"one": [(1, 2.0)]}, "i", "mm"),
        plots.bar("lagoon", 0.0, 2.5, "mm"),
    ):
        assert ElementTree.fromstring(drawn).tag.endswith("svg")
        assert "nan" not in drawn and "inf" not in drawn
    assert plots.histogram({}, "x") == "" and plots.curves({"a": [(1, 0.0)]}, "i", "mm") == ""


def test_a_legend_shows_its_ends_whole():
    drawn = ElementTree.fromstring(plots.bar("lagoon", -0.000123, 123456.0, "mm"))
    _, *ends = [one for one in drawn.iter() if one.tag.endswith("text")]
    assert [one.text for one in ends] == ["-0.000123", "6.173e+04", "1.23e+05"]
    places = [(one.get("text-anchor"), float(one.get("x"))) for one in ends]
    assert places == [("start", 20.0), ("middle", 180.0), ("end", 340.0)], "centred ends leave the picture"


def test_a_histogram_has_the_shares():
    drawn = ElementTree.fromstring(plots.histogram({"": [0.0] * 3 + [1.0]}, "x"))
    polygon = next(one for one in drawn.iter() if one.tag.endswith("polygon"))
    ys = np.array([[float(v) for v in p.split(",")] for p in polygon.get("points").split()])[:, 1]
    heights = ys.max() - ys
    assert heights[1] == pytest.approx(3 * heights[-2], rel=0.02)


def test_ticks_are_round_and_within():
    for low, high in ((0, 1), (-3.2, 17), (1e-5, 4e-5), (1000, 1001)):
        found = plots.ticks(low, high)
        assert 2 <= len(found) <= 9 and low - 1e-12 <= found[0] and found[-1] <= high * (1 + 1e-12)


def test_a_mesh_has_a_page_too():
    bone = pair(600, 600).source
    sections = mesh_figures(bone, bone.moved(bone.vertices + 1.0), {"gap": bone.vertices[:, 0]}, "mm")
    page = report_html.html("Quality", "", sections)
    assert "Gap (mm)" in page and "With the other mesh" in page and not Page(page).open


def test_a_page_counts_the_nodes_of_triangles_in_a_heap_once():
    """Those of an STL file: its histograms and distances are those of the merged mesh."""
    heap = Surface(*soup())
    first, which = placed(heap.vertices)
    merged = Surface(heap.vertices[first], which[heap.faces])
    assert len(first) < len(heap.vertices) / 4
    values = {"displacement": merged.vertices[:, 0] - merged.vertices[:, 0].min()}
    spread = {"displacement": values["displacement"][which]}
    assert mesh_figures(heap, heap, spread)[1] == mesh_figures(merged, merged, values)[1]
    pages = [
        morph_figures(one, one.moved(1.1 * one.vertices), one.moved(1.2 * one.vertices), known)
        for one, known in ((heap, spread), (merged, values))
    ]
    assert pages[0][1] == pages[1][1]


def test_a_page_keeps_what_vertices_at_one_place_differ_in():
    """An unused vertex that stands first does not count, and one of another shell does."""
    ball = pair(100, 100).source
    apart = Surface(np.vstack((ball.vertices, ball.vertices)), ball.faces + len(ball.vertices))
    values = {"displacement": np.repeat((0.0, 5.0), len(ball.vertices))}
    page = report_html.html("t", "", mesh_figures(apart, None, values, "mm"))
    assert "0 everywhere" not in page and "Displacement (mm)" in page
    both = Surface(apart.vertices, np.vstack((ball.faces, apart.faces)))
    one = {"displacement": np.full(len(ball.vertices), 5.0)}
    assert mesh_figures(apart, None, values)[1] == mesh_figures(ball, None, one)[1]
    assert mesh_figures(both, None, values)[1] != mesh_figures(ball, None, one)[1]


def test_each_body_of_a_page_has_a_colour_of_its_own():
    spheres = [Body(f"b{n}", sphere(1, 1.0, (3.0 * n, 0.0, 0.0))) for n in range(40)]
    pictures = overclosure_figures(spheres, None, 0.1)[0]
    key = next(item.content for item in pictures.items if getattr(item, "caption", "") == "Which is which.")
    assert len(set(re.findall(r"rgb\([0-9,]+\)", key))) == 40 and ">b39</text>" in key


def test_the_deepest_bodies_have_pictures():
    """Pairs of which the last is the deepest: more than have pictures."""
    places = [(20.0 * n + side * (1.9 - 0.1 * n), 0.0, 0.0) for n in range(5) for side in (0, 1)]
    bodies = [Body(f"b{row}", sphere(2, 1.0, place)) for row, place in enumerate(places)]
    told = [item for item in overclosure_figures(bodies, None, 0.5)[0].items if isinstance(item, str)]
    named = [one.split(",")[0] for one in told if one.startswith("b")]
    assert {"b8", "b9", "b6", "b7"} <= set(named) and "b0" not in named, told


def test_a_page_shows_triangles_wound_either_way_alike():
    heap = Surface(*soup())
    turned = heap.faces.copy()
    turned[::2] = turned[::2, ::-1]
    assert mesh_figures(heap, None, {}) == mesh_figures(Surface(heap.vertices, turned), None, {})
