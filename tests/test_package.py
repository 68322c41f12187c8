# SPDX-License-Identifier: GPL-3.0-or-later
"""The zips: the same bytes every time, all that they name in them, and nothing that Blender has."""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

packaging = pytest.importorskip("packaging", reason="zips are built with the Python of .venv")

from package import build, wheels  # noqa: E402
from package.targets import BUILDS, OFFICIAL, PROVIDED, ROOT, Build  # noqa: E402
from package.wheels import PackageError, Wheel  # noqa: E402

ONE = Build("linux-x64", "linux-x64", (), {"3.11": {"thing": "1.0"}, "3.13": {"thing": "1.0"}})


def wheel(folder: Path, python: str, requires: str = "numpy>=1.20", **changed) -> Wheel:
    """Write a wheel that holds little more than its own description, and return its line of a lock."""
    tag = "cp" + python.replace(".", "")
    name = changed.pop("file", f"thing-1.0-{tag}-{tag}-manylinux_2_17_x86_64.whl")
    with zipfile.ZipFile(folder / name, "w") as archive:
        archive.writestr(
            "thing-1.0.dist-info/METADATA", f"Name: thing\nVersion: 1.0\nRequires-Dist: {requires}\n"
        )
    values = {"name": "thing", "version": "1.0", "licence": "MIT", "python": python, "builds": ("linux-x64",)}
    path = folder / name
    values |= {"file": name, "sha256": wheels.digest(path), "bytes": path.stat().st_size}
    return Wheel(**(values | changed))


@pytest.fixture()
def cache(tmp_path, monkeypatch):
    """A folder of wheels of our own, and no network."""
    folder = tmp_path / "wheels"
    folder.mkdir()
    monkeypatch.setattr(wheels, "CACHE", folder)

    def refuse(*arguments):
        raise PackageError("pip was asked")

    monkeypatch.setattr(wheels, "pip_download", refuse)
    return folder


@pytest.fixture()
def checkout(tmp_path):
    """A copy of what goes into a zip."""
    root = tmp_path / "checkout"
    root.mkdir()
    for name in (*build.FILES, build.MANIFEST):
        shutil.copy(ROOT / name, root)
    for room in build.ROOMS:
        shutil.copytree(ROOT / room, root / room, ignore=shutil.ignore_patterns("__pycache__"))
    return root


def contents(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        assert len(archive.namelist()) == len(set(archive.namelist()))
        return {name: archive.read(name) for name in archive.namelist()}


def test_two_builds_are_the_same_whatever_the_clock_and_the_folder_say(cache, checkout, tmp_path):
    lock = [wheel(cache, "3.11"), wheel(cache, "3.13")]
    first = build.make(ONE, lock, tmp_path / "a", checkout).read_bytes()
    other = tmp_path / "other"
    other.mkdir()
    for path in sorted((p for p in checkout.rglob("*") if p.is_file()), reverse=True):
        place = other / path.relative_to(checkout)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(path.read_bytes())
        os.utime(place, (1e9, 1e9))
        place.chmod(0o700)
    for junk in ("ui/__pycache__/panels.cpython-311.pyc", "ui/panels.py~", "ui/.panels.py.swp", "notes.txt"):
        (other / junk).parent.mkdir(exist_ok=True)
        (other / junk).write_text("junk")
    assert build.make(ONE, lock, tmp_path / "b", other).read_bytes() == first
    (other / "ui" / "panels.py").write_bytes(b"# changed\n")
    assert build.make(ONE, lock, tmp_path / "c", other).read_bytes() != first
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["femors-0.1.0-linux-x64.zip"]


def test_what_is_in_a_zip(cache, checkout, tmp_path):
    lock = [wheel(cache, "3.11"), wheel(cache, "3.13")]
    inside = contents(build.make(ONE, lock, tmp_path, checkout))
    said, own = (
        tomllib.loads(inside[build.MANIFEST].decode()),
        tomllib.loads((ROOT / build.MANIFEST).read_text()),
    )
    assert said["platforms"] == ["linux-x64"]
    assert {path.removeprefix("./") for path in said["wheels"]} == {n for n in inside if n.endswith(".whl")}
    assert said["permissions"] == own["permissions"] and "build" not in said
    for item in lock:
        assert hashlib.sha256(inside[f"wheels/{item.file}"]).hexdigest() == item.sha256
        assert item.file in inside["THIRD_PARTY.md"].decode()
    for path in [
        *ROOT.glob("femors_addon/**/*.py"),
        *ROOT.glob("operators/**/*.py"),
        *ROOT.glob("ui/**/*.py"),
    ]:
        assert inside[path.relative_to(ROOT).as_posix()] == path.read_bytes()


def test_a_spoilt_wheel_is_fetched_again_or_refused(cache, checkout, tmp_path):
    lock = [wheel(cache, "3.11"), wheel(cache, "3.13")]
    (cache / lock[1].file).write_bytes(b"half of it")
    with pytest.raises(PackageError, match="pip was asked"):
        build.make(ONE, lock, tmp_path / "out", checkout)
    assert not (tmp_path / "out").exists()


def test_what_pip_brings_must_be_what_the_lock_says(cache, monkeypatch):
    item = wheel(cache, "3.11")
    (cache / item.file).unlink()
    asked = []

    def download(lines, build, python, folder):
        asked.extend(lines)
        (folder / item.file).write_bytes(b"another")
        return [folder / item.file]

    monkeypatch.setattr(wheels, "pip_download", download)
    with pytest.raises(PackageError, match="is not what"):
        wheels.fetch([item], ONE)
    assert asked == [f"thing==1.0 --hash=sha256:{item.sha256}"]


@pytest.mark.parametrize(
    ("lock", "words"),
    [
        (lambda c: [wheel(c, "3.11")], "3.13: the lock has {}"),
        (lambda c: [wheel(c, "3.11"), wheel(c, "3.13", version="1.1")], "wanted are"),
        (lambda c: [wheel(c, "3.11", "numpy<1.26"), wheel(c, "3.13")], "wants numpy<1.26"),
        (lambda c: [wheel(c, "3.11", "other"), wheel(c, "3.13")], "wants other"),
        (
            lambda c: [wheel(c, "3.11"), wheel(c, "3.13", file="thing-1.0-cp313-cp313-win_amd64.whl")],
            "another platform",
        ),
        (
            lambda c: [
                wheel(c, "3.11", file="thing-1.0-cp312-cp312-manylinux1_x86_64.whl"),
                wheel(c, "3.13"),
            ],
            "another platform or Python",
        ),
    ],
)
def test_a_lock_that_does_not_do_is_refused(cache, checkout, tmp_path, lock, words):
    with pytest.raises(PackageError, match=re.escape(words)):
        build.make(ONE, lock(cache), tmp_path / "out", checkout)
    assert not (tmp_path / "out").exists()


def test_what_blender_would_not_take_is_refused(cache, checkout, tmp_path):
    if build.blender_scripts() is None:
        pytest.skip("Blender's validator comes with the bpy wheel")
    path = checkout / build.MANIFEST
    path.write_text(path.read_text().replace('"Mesh"', '"Bones"'))
    with pytest.raises(PackageError, match=r"is not valid: .*Bones"):
        build.make(ONE, [wheel(cache, "3.11"), wheel(cache, "3.13")], tmp_path / "out", checkout)
    assert not list((tmp_path / "out").iterdir())


def test_another_build_that_differs_is_told(cache, tmp_path):
    lock = [wheel(cache, "3.11"), wheel(cache, "3.13")]
    path = build.make(ONE, lock, tmp_path)
    build.compare(ONE, lock, tmp_path)
    path.write_bytes(path.read_bytes() + b"0")
    with pytest.raises(PackageError, match="is not what another build gives"):
        build.compare(ONE, lock, tmp_path)


def test_numpy_is_refused(cache, checkout, tmp_path):
    numpy = {"name": "numpy", "file": "numpy-2.0-cp311-cp311-manylinux_2_17_x86_64.whl", "version": "2.0"}
    lock = [wheel(cache, "3.11", **numpy)]
    greedy = dataclasses.replace(ONE, pythons={"3.11": {"numpy": "2.0"}})
    with pytest.raises(PackageError, match="may not be in a package"):
        build.make(greedy, lock, tmp_path / "out", checkout)


def test_a_zip_whose_wheels_are_not_those_it_names_is_refused(cache, tmp_path):
    lock = [wheel(cache, "3.11"), wheel(cache, "3.13")]
    text = build.manifest((ROOT / build.MANIFEST).read_text(), "linux-x64", lock)
    path = tmp_path / "a.zip"
    whole = {f"wheels/{item.file}": item.path.read_bytes() for item in lock}
    build.write_zip(path, {build.MANIFEST: text.encode(), **whole})
    build.check_zip(path, lock)
    build.write_zip(path, {build.MANIFEST: text.encode(), **dict(list(whole.items())[:1])})
    with pytest.raises(PackageError, match="names other wheels"):
        build.check_zip(path, lock)
    build.write_zip(path, {build.MANIFEST: text.encode(), **dict.fromkeys(whole, b"modified")})
    with pytest.raises(PackageError, match="is not what the lock says"):
        build.check_zip(path, lock)


def test_the_lock_has_every_package_of_every_build():
    """Without the wheels themselves: names, versions, platforms and Pythons."""
    lock = wheels.read_lock()
    assert {item.name for item in lock}.isdisjoint(PROVIDED)
    for one in BUILDS:
        mine = [item for item in lock if one.name in item.builds]
        for python, packages in one.pythons.items():
            here = sorted((i.name, i.version) for i in mine if i.python in (python, "any"))
            assert here == sorted(packages.items()), (one.name, python)
        assert all(wheels.fits(item.file, one, item.python) for item in mine)
        assert {item.python for item in mine} == {"any", *one.pythons}
    assert {one.platform for one in BUILDS if one.pythons is OFFICIAL} == {
        "linux-x64",
        "windows-x64",
        "macos-arm64",
        "macos-x64",
    }


def test_versions_in_the_zips_are_those_that_the_tests_of_the_core_run_with():
    text = (ROOT / "requirements" / "venv.txt").read_text()
    pins = dict(re.findall(r"^([\w-]+)==(\S+)", text, re.MULTILINE))
    pins = {wheels.canonical(name): version for name, version in pins.items()}
    for name, version in OFFICIAL["3.11"].items():
        assert pins[name] == version, name


def test_whatever_is_imported_is_in_the_zips():
    """A package that the core begins to use has to be added to targets.py, or taken out again."""
    modules = {name.replace("-", "_") for name in OFFICIAL["3.11"]}
    blender = {
        "bpy",
        "bmesh",
        "mathutils",
        "gpu",
        "gpu_extras",
        "blf",
        "bl_math",
        "addon_utils",
        "bpy_extras",
        "bl_operators",
    }
    allowed = modules | blender | {*sys.stdlib_module_names, "numpy"}
    seen = set()
    for room in build.ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.level == 0:
                    names = [str(node.module)]
                for name in names:
                    seen.add(name.split(".")[0])
                    assert name.split(".")[0] in allowed, f"{path} imports {name}"
    assert {"scipy", "fast_simplification"} <= seen


def test_every_room_is_in_the_zip_or_left_out_on_purpose():
    """What `blender --command extension build` would take is what `make package` takes."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("not a Git checkout, or no Git, as beside a Blender of Debian's")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    top = {name.split("/")[0] + "/" * ("/" in name) for name in listed.decode().split("\0") if name}
    out = tomllib.loads((ROOT / build.MANIFEST).read_text())["build"]["paths_exclude_pattern"]
    kept = {name for name in top if f"/{name}" not in out and not name.startswith(".")}
    assert kept == {*build.FILES, build.MANIFEST, *(f"{room}/" for room in build.ROOMS)}


def test_the_manifest_keeps_the_platforms_rules():
    """Of extensions.blender.org; Blender's own `extension validate` looks at the rest."""
    said = tomllib.loads((ROOT / build.MANIFEST).read_text())
    assert len(said["tagline"]) <= 64 and said["tagline"][-1].isalnum()
    assert "blender" not in said["name"].lower()
    assert said["license"] == ["SPDX:GPL-3.0-or-later"]
    assert set(said["permissions"]) == {"files"}
    assert all(len(text) <= 64 and text[-1].isalnum() for text in said["permissions"].values())


def test_no_network_and_no_path_tricks():
    """Nor files anywhere but where the user says, as far as a machine can read that."""
    forbidden = re.compile(
        r"^\s*(?:import|from)\s+(?:socket|urllib\.request|http|requests|ftplib|ssl|pip|ensurepip)\b"
        r"|\bsys\.path\b|\bsubprocess\b",
        re.MULTILINE,
    )
    for room in build.ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            found = forbidden.search(path.read_text(encoding="utf-8"))
            assert found is None, f"{path}: {found and found[0]}"
