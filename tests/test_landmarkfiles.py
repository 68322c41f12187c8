# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmark files: what each kind says, LPS and RAS, what stays when they are written again, what is told."""

from __future__ import annotations

import json

import numpy as np
import pytest

from femors_addon import landmarkfiles
from femors_addon.landmarkfiles import Landmarks, encoded, read
from femors_addon.progress import FemorsError

POINTS = np.array([[1.5, -2.25, 3.0], [10.0, 20.0, 30.0], [-0.125, 0.0, 1e-3]])
NAMES = ("head", "lateral, distal", "Ä")
ENDINGS = (".csv", ".fcsv", ".mrk.json", ".json")


def written(tmp_path, ending: str, text: str):
    path = tmp_path / f"marks{ending}"
    path.write_text(text, encoding="utf-8")
    return path


# --- there and back -------------------------------------------------------------------------------
@pytest.mark.parametrize("space", ["LPS", "RAS"])
@pytest.mark.parametrize("ending", ENDINGS)
def test_every_kind_comes_back(tmp_path, ending, space):
    path = tmp_path / f"marks{ending}"
    path.write_bytes(encoded(path, Landmarks(POINTS, NAMES, space=space)))
    back = read(path, space)
    assert np.array_equal(back.points, POINTS)
    assert back.names == NAMES
    assert back.labels == NAMES


@pytest.mark.parametrize("ending", [".fcsv", ".mrk.json"])
def test_the_same_points_in_either_system(tmp_path, ending):
    """A file in RAS and one in LPS of the same patient give the same landmarks."""
    lps, ras = tmp_path / f"lps{ending}", tmp_path / f"ras{ending}"
    lps.write_bytes(encoded(lps, Landmarks(POINTS, NAMES)))
    ras.write_bytes(encoded(ras, Landmarks(POINTS * [-1, -1, 1], NAMES, space="RAS")))
    assert "RAS" in ras.read_text() and "LPS" in lps.read_text()
    for space in ("LPS", "RAS"):
        assert np.array_equal(read(lps, space).points, read(ras, space).points)
    assert np.array_equal(read(ras, "LPS").points, POINTS)
    assert np.array_equal(read(lps, "RAS").points, POINTS * [-1, -1, 1])


@pytest.mark.parametrize(
    ("line", "lps"),
    [
        ("# CoordinateSystem = LPS", True),
        ("# CoordinateSystem = 1", True),
        ("# CoordinateSystem = RAS", False),
        ("# CoordinateSystem = 0", False),
        ("# Markups fiducial file version = 4.5", False),  # before it was written down: RAS
    ],
)
def test_what_an_fcsv_file_says_of_its_axes(tmp_path, line, lps):
    text = f"{line}\n# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
    path = written(tmp_path, ".fcsv", text + "v_1,1,2,3,0,0,0,1,1,1,0,F-1,words,node\n")
    marks = read(path)
    assert marks.points.tolist() == ([[1, 2, 3]] if lps else [[-1, -2, 3]])
    assert marks.names == ("F-1",)


def test_an_fcsv_file_keeps_all_but_its_points(tmp_path):
    text = (
        "# Markups fiducial file version = 4.11\n# CoordinateSystem = RAS\n"
        "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
        'v_1,1,2,3,0,0,0,1,1,0,1,"a, b",some words,vtkMRMLScalarVolumeNode1\n\n'
        "v_2,4,5,6,0,0,0,1,0,1,0,c,,\n"
    )
    path = written(tmp_path, ".fcsv", text)
    marks = read(path)
    moved = encoded(path, marks.with_points(marks.points + [1, 1, 1])).decode()
    assert moved == text.replace("1,2,3,0", "0,1,4,0", 1).replace("4,5,6,0", "3,4,7,0", 1)


def test_a_mrk_json_file_keeps_all_but_its_points(tmp_path):
    document = {
        "@schema": "x",
        "markups": [
            {
                "type": "Fiducial",
                "coordinateSystem": "RAS",
                "controlPoints": [
                    {"id": "1", "label": "a", "position": [1, 2, 3], "locked": True, "description": "d"},
                    {"id": "2", "label": "gone", "position": [0, 0, 0], "positionStatus": "undefined"},
                ],
                "display": {"color": [1, 0, 0]},
            },
            {"type": "Curve", "controlPoints": [{"id": "1", "label": "b", "position": [7, 8, 9]}]},
        ],
    }
    path = written(tmp_path, ".mrk.json", json.dumps(document))
    marks = read(path)
    assert marks.names == ("a", "b")
    assert marks.points.tolist() == [[-1, -2, 3], [7, 8, 9]]  # the second is in LPS, which is not said
    after = json.loads(encoded(path, marks.with_points(marks.points * 2)))
    expected = json.loads(json.dumps(document))
    expected["markups"][0]["controlPoints"][0]["position"] = [2, 4, 6]
    expected["markups"][1]["controlPoints"][0]["position"] = [14, 16, 18]
    assert after == expected


@pytest.mark.parametrize(
    ("text", "after"),
    [
        ("1,2,3\n4,5,6\n", "2,3,4\n5,6,7\n"),
        ("name,x,y,z\na,1,2,3\n", "name,x,y,z\na,2,3,4\n"),
        ("# note\n\nz;x;name;y;side\n3;1;a;2;left\n", "# note\n\nz;x;name;y;side\n4;2;a;3;left\n"),
        ('a\t1\t2\t3\n"b c"\t4\t5\t6\n', "a\t2\t3\t4\nb c\t5\t6\t7\n"),
    ],
)
def test_a_csv_file_keeps_its_columns_lines_and_marks(tmp_path, text, after):
    path = written(tmp_path, ".csv", text)
    marks = read(path)
    assert encoded(path, marks.with_points(marks.points + 1)).decode() == after


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["plain", "marked"])
@pytest.mark.parametrize("ending", [".csv", ".fcsv"])
def test_line_ends_and_the_mark_by_which_a_spreadsheet_knows_utf8_stay(tmp_path, ending, mark, end):
    path = tmp_path / f"marks{ending}"
    text = f"{mark}Köpfchen,1,2,3{end}{end}b,4,5,6{end}"
    path.write_bytes(text.encode())
    marks = read(path)
    assert encoded(path, marks) == text.encode()
    moved = encoded(path, marks.with_points(marks.points + 1))
    assert moved.count(b"\r") == text.count("\r") and moved.startswith(f"{mark}Köpfchen,".encode())
    fresh = encoded(tmp_path / f"other{ending}", Landmarks(marks.points, ("a", "b")))
    assert b"\r" not in fresh and not fresh.startswith("\ufeff".encode())


def test_another_kind_is_made_from_scratch(tmp_path):
    path = written(tmp_path, ".csv", "x,y,z\n1,2,3\n4,5,6\n")
    other = tmp_path / "out.fcsv"
    other.write_bytes(encoded(other, read(path)))
    assert read(other).names == ("1", "2")
    assert read(other).points.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_figures_stand_beside_the_points(tmp_path):
    beside = {"residual": [0.25, float("nan"), 1.0], "templates": [1, 2, 3]}
    text = encoded("t.csv", Landmarks(POINTS, NAMES), beside).decode().splitlines()
    assert text[0] == "name,x,y,z,residual,templates"
    assert text[2] == '"lateral, distal",10,20,30,,2'
    path = written(tmp_path, ".csv", "\n".join(text))
    assert read(path).names == NAMES


# --- what is told ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("ending", "text", "words"),
    [
        (".csv", "name,x,y,z\na,1,2,3\na,4,5,6\n", "'a' stands twice"),
        (".fcsv", "v,1,2,3,0,0,0,1,1,1,0,a\nv,1,2,4,0,0,0,1,1,1,0,a\n", "'a' stands twice"),
        (".fcsv", "# CoordinateSystem = IJK\nv,1,2,3\n", "neither LPS nor RAS"),
        (".fcsv", "# columns = id,x,y,z\n", "no landmarks"),
        (".fcsv", "v,1,two,3\n", "line 1: three finite numbers"),
        (".fcsv", "v,1,2\n", "line 1: three finite numbers"),
        (".mrk.json", "{", "not a JSON file"),
        (".mrk.json", "[]", "no list 'markups'"),
        (".mrk.json", '{"markups": [3]}', "without a list of control points"),
        (".mrk.json", '{"markups": [{"controlPoints": []}]}', "no landmarks"),
        (".mrk.json", '{"markups": [{"controlPoints": [{"position": [1, 2]}]}]}', "control point 1"),
        (".mrk.json", '{"markups": [{"controlPoints": [{"position": [1, 2, NaN]}]}]}', "control point 1"),
        (
            ".mrk.json",
            f'{{"markups": [{{"controlPoints": [{{"position": [1{"0" * 400}, 2, 3]}}]}}]}}',
            "point 1: three",
        ),
        (".mrk.json", '{"markups": [{"coordinateSystem": "XYZ", "controlPoints": []}]}', "neither LPS"),
    ],
)
def test_what_is_wrong_is_told_in_a_line(tmp_path, ending, text, words):
    path = written(tmp_path, ending, text)
    with pytest.raises(FemorsError, match=words) as error:
        read(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_an_ending_that_is_none_is_told(tmp_path):
    with pytest.raises(FemorsError, match="is a folder; name a file"):
        landmarkfiles.ending_of(tmp_path)
    with pytest.raises(FemorsError, match="no kind of landmark file"):
        landmarkfiles.ending_of("marks.xlsx")
    assert landmarkfiles.is_landmarks("A.MRK.JSON")
    assert not landmarkfiles.is_landmarks("bone.stl")


# --- what CSV files look like ---------------------------------------------------------------------
@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("# made in X; 2024\nname,x,y,z\na,1,2,3\nb,4,5,6\n", ("a", "b")),
        ("name,x,y,z\na;left,1,2,3\nb,4,5,6\n", ("a;left", "b")),
        ("name;x;y;z\na,b;1;2;3\nc;4;5;6\n", ("a,b", "c")),
        ("x,y,z,radius\n1,2,3,5\n4,5,6,5\n", ()),
        ("x,y,z,where\n1,2,3,left\n4,5,6,right\n", ("left", "right")),
        ("id,name,x,y,z\n1,a,1,2,3\n2,b,4,5,6\n", ("a", "b")),
        ("id,x,y,z\n7,1,2,3\n9,4,5,6\n", ("7", "9")),
        ("Name,X (mm),Y (mm),Z [mm]\na,1,2,3\nb,4,5,6\n", ("a", "b")),
        ("a,1,2,3\n,4,5,6\n", ("a", "2")),
    ],
)
def test_columns_and_names_are_found(tmp_path, text, names):
    marks = read(written(tmp_path, ".csv", text))
    assert marks.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert marks.names == names


@pytest.mark.parametrize(
    ("text", "names", "after"),
    [
        ('"a\nb",1,2,3\nc,4,5,6\n', ("a\nb", "c"), '"a\nb",2,3,4\nc,5,6,7\n'),
        (
            '"a\r\n\r\n#b",1,2,3\r\n# c "\r\n"d",4,5,6',
            ("a\r\n\r\n#b", "d"),
            '"a\r\n\r\n#b",2,3,4\r\n# c "\r\nd,5,6,7\r\n',
        ),
        ('"a\rb",1,2,3\nc,4,5,6\n', ("a\rb", "c"), '"a\rb",2,3,4\nc,5,6,7\n'),
        ('x;"y\n(mm)";z;name\n1;2;3;a\n4;5;6;b\n', ("a", "b"), 'x;"y\n(mm)";z;name\n2;3;4;a\n5;6;7;b\n'),
        ("a\u2028b,1,2,3\nc\x85d,4,5,6\n", ("a\u2028b", "c\x85d"), "a\u2028b,2,3,4\nc\x85d,5,6,7\n"),
        ("a\fb,1,2,3\n\nc\x1cd,4,5,6\n", ("a\fb", "c\x1cd"), "a\fb,2,3,4\n\nc\x1cd,5,6,7\n"),
        ("a,1,2,3\rb,4,5,6\r", ("a", "b"), "a,2,3,4\rb,5,6,7\r"),
    ],
)
def test_line_breaks_in_names_of_a_csv_file(tmp_path, text, names, after):
    path = tmp_path / "marks.csv"
    path.write_bytes(text.encode())
    marks = read(path)
    assert marks.names == names
    assert marks.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    out = encoded(path, marks.with_points(marks.points + 1))
    assert out.decode() == after
    for content in (out, encoded(path, Landmarks(marks.points + 1, names))):  # and from scratch
        path.write_bytes(content)
        assert read(path).names == names
        assert read(path).points.tolist() == [[2, 3, 4], [5, 6, 7]]


def test_names_that_look_like_comments_and_spaces_after_quotes(tmp_path):
    path = tmp_path / "odd.csv"
    path.write_bytes(encoded(path, Landmarks(np.arange(6.0).reshape(2, 3), ("#1", "b"))))
    assert read(path).names == ("#1", "b")
    path.write_text('"a\nb" ,1,2,3\nc,4,5,6\n')
    assert read(path).names == ("a\nb", "c")


def test_line_breaks_in_names_elsewhere(tmp_path):
    """U+2028 does not end a line of an fcsv file; what does is a space there. Messages stay one line."""
    names = ("a\u2028b", "c\nd", "e")
    for ending, expected in ((".fcsv", ("a\u2028b", "c d", "e")), (".mrk.json", names)):
        path = tmp_path / f"marks{ending}"
        path.write_bytes(encoded(path, Landmarks(POINTS, names)))
        assert read(path).names == expected
        path.write_bytes(encoded(path, read(path).with_points(POINTS + 1)))
        assert read(path).names == expected
        assert np.array_equal(read(path).points, POINTS + 1)
    with pytest.raises(FemorsError, match=r"of the same name: a[?]b, c[?]d, f, g\)$"):
        landmarkfiles.paired(Landmarks(POINTS, names), Landmarks(POINTS, ("f", "g", "e")))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('x,y,z,note\n1,2,3,"5 mm\n4,5,6,b\n', "line 2: is not a row of a CSV file; close the quote"),
        ('a,1,2,3,"5 mm\nb,4,5,6,7"\nc,7,8,9,x\n', "line 1: is not a row of a CSV file; close the quote"),
        ('a,1,2,3\n"b\nc",4,5,6\nd,7,8\n', "line 4: 4 values are needed, not 3"),
        ("1,5;2,5;3,5\n4,5;5,5;6,5\n", "decimal commas"),
        ("name;x;y;z\na;1,5;2,5;3,5\n", "decimal commas"),
        ("1 2 3\n4 5 6\n", "spaces between"),
        ("a 1.5  2 3\n", "spaces between"),
        ("a,1,2,3\n2,4,5,6\n,7,8,9\n2,1,1,1\n", "'2' stands twice"),
    ],
)
def test_other_kinds_of_tables_are_told(tmp_path, text, words):
    with pytest.raises(FemorsError, match=words):
        read(written(tmp_path, ".csv", text))


# --- as the command line reads them ----------------------------------------------------------------
ROWS = np.array([[1, 2, 3.5], [-4, 5, 6], [7, 8, -9e1], [0, 1, 0]])


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("1,2,3.5\n-4,5,6\n7, 8, -9e1\n0,1,0", ()),
        ("x,y,z\n1,2,3.5\n\n# a remark\n-4,5,6\n7,8,-90\n0,1,0\n", ()),
        ("\ufeffname;x;y;z\r\na;1;2;3.5\r\nb;-4;5;6\r\nc;7;8;-90\r\nd;0;1;0\r\n", ("a", "b", "c", "d")),
        ('"a, front",1,2,3.5\nb,-4,5,6\nc,7,8,-90\nd,0,1,0\n', ("a, front", "b", "c", "d")),
        ("z\ty\tx\tlabel\n3.5\t2\t1\ta\n6\t5\t-4\tb\n-90\t8\t7\tc\n0\t1\t0\td\n", ("a", "b", "c", "d")),
    ],
)
def test_landmark_files(tmp_path, text, names):
    path = tmp_path / "points.csv"
    path.write_text(text, encoding="utf-8", newline="")
    landmarks = landmarkfiles.read(path)
    assert np.array_equal(landmarks.points, ROWS)
    assert landmarks.names == names


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y,z\n", "no landmarks"),
        ("1,2\n", "line 1: .* not 2 values"),
        ("1,2,3\n4,5\n", "line 2: 3 values are needed, not 2"),
        ("1,2,3\n4,five,6\n", "line 2: 'five' is not a number"),
        ("1,2,3\n4,1_0,6\n", "line 2: '1_0' is not a number"),
        ("1,2,inf\n", "line 1: .* not finite"),
        ("a,1,2,3\na,4,5,6\n", "'a' stands twice"),
    ],
)
def test_landmark_files_that_are_refused(tmp_path, text, words):
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(FemorsError, match=words) as caught:
        landmarkfiles.read(path)
    assert str(caught.value).startswith(str(path))


def test_landmarks_are_paired_by_name_or_by_order():
    names = ("a", "b", "c", "d")
    shuffled = [2, 0, 3, 1]
    target = landmarkfiles.Landmarks(ROWS[shuffled] + 1, tuple(names[i] for i in shuffled))
    found = landmarkfiles.paired(landmarkfiles.Landmarks(ROWS, names), target)
    assert np.array_equal(found.target, found.source + 1) and found.names == names and not found.notes
    more = landmarkfiles.Landmarks(np.append(ROWS, [[9, 9, 9]], axis=0), (*names, "e"))
    found = landmarkfiles.paired(more, target)
    assert np.array_equal(found.target, found.source + 1) and found.names == names
    assert found.notes == ["landmarks without a partner of the same name: e; left out"]
    found = landmarkfiles.paired(landmarkfiles.Landmarks(ROWS), target)
    assert np.array_equal(found.target, ROWS[shuffled] + 1) and not found.names and not found.notes
    with pytest.raises(FemorsError, match=r"2 pairs .* at least 3 .* of the same name: c, d, e, f"):
        landmarkfiles.paired(
            landmarkfiles.Landmarks(ROWS, names), landmarkfiles.Landmarks(ROWS, ("a", "b", "f", "e"))
        )
    with pytest.raises(FemorsError, match="4 source landmarks and 3 target"):
        landmarkfiles.paired(landmarkfiles.Landmarks(ROWS), landmarkfiles.Landmarks(ROWS[:3]))
    with pytest.raises(FemorsError, match="at least 3"):
        landmarkfiles.paired(landmarkfiles.Landmarks(ROWS[:2]), landmarkfiles.Landmarks(ROWS[:2]))
