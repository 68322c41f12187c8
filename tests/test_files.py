# SPDX-License-Identifier: GPL-3.0-or-later
"""Files as a whole: written, or as they were; folders; links; devices."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from meshtexts import saved

from femors_addon import files
from femors_addon.progress import FemorsError


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = saved(tmp_path / "result.stl", b"precious")
    other = tmp_path / "report.json"
    with pytest.raises(RuntimeError), files.replacing(path, other) as (one, two):
        one.write_bytes(b"half")
        two.write_bytes(b"half")
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["result.stl"]
    assert path.read_bytes() == b"precious"
    with files.replacing(path, other) as (one, two):
        one.write_bytes(b"whole")
        two.write_bytes(b"too")
    assert (path.read_bytes(), other.read_bytes()) == (b"whole", b"too")
    assert len(list(tmp_path.iterdir())) == 2


def test_folders_that_were_made_go_again_where_the_work_fails(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    for folder in ("mine/a/b/c", tmp_path / "x" / "y", "mine/new/../other"):
        with pytest.raises(RuntimeError), files.folder_for(folder):
            assert os.path.isdir(folder)
            raise RuntimeError
        assert [path.name for path in tmp_path.rglob("*")] == ["mine"]
    too_long = "n" * 300
    with pytest.raises(FemorsError, match=f"{too_long}: cannot be made"), files.folder_for(f"a/b/{too_long}"):
        raise AssertionError
    assert [path.name for path in tmp_path.rglob("*")] == ["mine"]
    with pytest.raises(RuntimeError), files.folder_for("a/b"):
        (tmp_path / "a" / "note.txt").write_text("of somebody else")
        raise RuntimeError
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "mine", "note.txt"]
    with files.folder_for("a/b/c"), files.folder_for("mine"):
        pass
    assert (tmp_path / "a" / "b" / "c").is_dir()


def test_writing_through_a_link_and_with_the_usual_permissions(tmp_path):
    (tmp_path / "real").mkdir()
    link = tmp_path / "link.stl"
    link.symlink_to(tmp_path / "real" / "x.stl")
    files.write_bytes(link, b"abc")
    assert link.is_symlink()
    assert (tmp_path / "real" / "x.stl").read_bytes() == b"abc"
    plain = saved(tmp_path / "plain", b"")
    assert (tmp_path / "real" / "x.stl").stat().st_mode == plain.stat().st_mode


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("nowhere/x.stl", "no folder"),
        ("", "folder"),
        ("/proc/x.stl", "cannot be written"),
        ("/dev/null", "regular"),
    ],
)
def test_places_that_cannot_be_written(tmp_path, name, word):
    if name.startswith("/") and not Path(name).parent.is_dir():
        pytest.skip(f"no {name} here")
    path = tmp_path / name
    for attempt in (lambda: files.check_writable(path), lambda: files.write_bytes(path, b"x")):
        with pytest.raises(FemorsError, match=word) as caught:
            attempt()
        assert str(path) in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_write_permission(tmp_path, monkeypatch):
    def denied(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "touch", denied)  # root may write anywhere, so the real thing would not fail
    with pytest.raises(FemorsError, match="permission denied"):
        files.check_writable(tmp_path / "x.stl")


def test_a_device_is_not_read():
    if not os.path.exists("/dev/zero"):
        pytest.skip("no /dev/zero here")
    with pytest.raises(FemorsError, match="regular"):
        files.read_bytes("/dev/zero")
