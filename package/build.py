# SPDX-License-Identifier: GPL-3.0-or-later
"""``make package``: the zips that users install, one for each platform.

    python -m package.build [--only NAME ...] [--out dist] [--check]

Each zip has the extension's rooms, a manifest made from blender_manifest.toml with the platform and its
wheels, the wheels as they were published, and the list of their licences. The same sources and lock give
the same bytes: nothing in a zip knows the time, the user or the order of a folder; ``--check`` builds once
more and compares. What is written is read again and compared with the lock, and looked at by Blender's own
``extension validate``, which the bpy wheel has too; a zip that does not pass never gets into ``dist``.
"""

from __future__ import annotations

import argparse
import filecmp
import hashlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from .targets import BUILDS, COMPANIONS, PROVIDED, ROOT, Build
from .wheels import PackageError, Wheel, canonical, digest, fetch, fits, read_lock, requires

ROOMS = ("femors_addon", "operators", "ui")
FILES = ("__init__.py", "LICENSE", "README.md", "CHANGELOG.md", "CITATION.cff")
MANIFEST = "blender_manifest.toml"
LICENCE_LIST = "THIRD_PARTY.md"
TIME = (1980, 1, 1, 0, 0, 0)
"""Of every file in a zip: the earliest that the format knows."""


def source_files(root: Path) -> Iterator[tuple[str, bytes]]:
    """Give the extension's own files by their path in the zip, in no particular order."""
    for name in FILES:
        yield name, (root / name).read_bytes()
    for room in ROOMS:
        for folder, folders, names in os.walk(root / room):
            folders[:] = [name for name in folders if name != "__pycache__" and not name.startswith(".")]
            for name in names:
                if not name.startswith(".") and not name.endswith((".pyc", "~", ".orig", ".rej")):
                    path = Path(folder, name)
                    yield path.relative_to(root).as_posix(), path.read_bytes()


def manifest(text: str, platform: str, wheels: Sequence[Wheel]) -> str:
    """Return the manifest of one zip: without ``[build]``, with the platform and its wheels.

    Parameters
    ----------
    text : str
        Of blender_manifest.toml.
    """
    lines, keep = [], True
    for line in text.split("\n"):
        if line.startswith("["):
            keep = line.strip() != "[build]"
        if keep:
            lines.append(line)
    first = next((i for i, line in enumerate(lines) if line.startswith("[")), len(lines))
    names = [f'  "./wheels/{wheel.file}",' for wheel in wheels]
    lines[first:first] = [f'platforms = ["{platform}"]', "wheels = [", *names, "]", ""]
    made = "\n".join(lines).rstrip("\n") + "\n"
    expected = tomllib.loads(text) | {
        "platforms": [platform],
        "wheels": [f"./wheels/{wheel.file}" for wheel in wheels],
    }
    expected.pop("build", None)
    if tomllib.loads(made) != expected:
        raise PackageError(f"{MANIFEST} is written in a way that package/build.py does not read")
    return made


def licence_list(wheels: Sequence[Wheel]) -> str:
    """Return the list of what the zip holds of others, and under which licences."""
    lines = [
        "# What this package holds of others",
        "",
        "FEMORS itself is under GPL-3.0-or-later, see LICENSE. The wheels below are the files that their",
        "authors published on PyPI, unmodified; each holds its licence's text in its `.dist-info` folder.",
        "",
        "| wheel | licence | with it | SHA-256 |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {wheel.file} | {wheel.licence} | {COMPANIONS.get(wheel.name, '')} | {wheel.sha256} |"
        for wheel in wheels
    ]
    return "\n".join(lines) + "\n"


def check_wheels(build: Build, wheels: Sequence[Wheel]) -> None:
    """Raise where a Python of the build lacks a package, or has one that Blender brings itself."""
    for python, packages in build.pythons.items():
        here = {wheel.name: wheel for wheel in wheels if wheel.python in (python, "any")}
        count = sum(wheel.python in (python, "any") for wheel in wheels)
        versions = {name: wheel.version for name, wheel in here.items()}
        wanted = {canonical(name): version for name, version in packages.items()}
        where = f"{build.name}, Python {python}"
        if versions != wanted or count != len(here):
            raise PackageError(f"{where}: the lock has {versions}, wanted are {wanted}; run make lock")
        for wheel in here.values():
            for needed in requires(wheel.path, python):
                name = canonical(needed.name)
                offered = PROVIDED[name][python] if name in PROVIDED else (versions.get(name, ""),)
                if not all(version and needed.specifier.contains(version) for version in offered):
                    raise PackageError(f"{where}: {wheel.file} wants {needed}, there is {offered}")
    for wheel in wheels:
        if wheel.name in PROVIDED:
            raise PackageError(f"{build.name}: {wheel.file} may not be in a package, Blender has its own")
        if not fits(wheel.file, build, wheel.python):
            raise PackageError(f"{build.name}: {wheel.file} is for another platform or Python")


def write_zip(path: Path, content: dict[str, bytes]) -> None:
    """Write a zip whose bytes depend on its content alone: in order, without time, stored.

    Stored, for wheels are compressed already, and compressors of other versions give other bytes.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(content):
            info = zipfile.ZipInfo(name, TIME)
            info.create_system = 3  # Unix, whatever this runs on
            info.external_attr = 0o100644 << 16
            archive.writestr(info, content[name])


def check_zip(path: Path, wheels: Sequence[Wheel]) -> None:
    """Read a zip again: its manifest names exactly the wheels that are in it, and they are the lock's."""
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        said = tomllib.loads(archive.read(MANIFEST).decode())["wheels"]
        inside = [name for name in names if name.endswith(".whl")]
        if sorted(said) != sorted(f"./{name}" for name in inside) or len(inside) != len(wheels):
            raise PackageError(f"{path.name}: the manifest names other wheels than are in it")
        for wheel in wheels:
            found = hashlib.sha256(archive.read(f"wheels/{wheel.file}")).hexdigest()
            if found != wheel.sha256:
                raise PackageError(f"{path.name}: {wheel.file} is not what the lock says")


def blender_scripts() -> Path | None:
    """Return the folder of Blender's own scripts in the bpy wheel, or nothing where there is no wheel."""
    wheel = importlib.util.find_spec("bpy")
    if wheel is None or not wheel.has_location:  # within a Blender binary it is no file
        return None
    return next(Path(str(wheel.origin)).parent.glob("*/scripts"), None)


def validate(path: Path) -> None:
    """Raise where Blender would not take the zip; where there is no bpy wheel, say so.

    The script is what ``blender --command extension validate`` runs, with Blender's list of tags.
    """
    scripts = blender_scripts()
    if scripts is None:
        print(f"{path.name}: not validated, for there is no bpy wheel", file=sys.stderr)
        return
    command = [sys.executable, str(scripts / "addons_core/bl_pkg/cli/blender_ext.py"), "validate"]
    tags = scripts / "modules" / "_bpy_internal" / "extensions" / "tags.py"
    command += ["--valid-tags", str(tags), str(path)]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    if done.returncode != 0:
        raise PackageError(f"{path.name} is not valid: {' '.join((done.stdout + done.stderr).split())}")


def make(build: Build, lock: Sequence[Wheel], out: Path, root: Path = ROOT) -> Path:
    """Build one zip into a folder and return its path."""
    wheels = [wheel for wheel in lock if build.name in wheel.builds]
    fetch(wheels, build)
    check_wheels(build, wheels)
    text = (root / MANIFEST).read_text()
    content = dict(source_files(root))
    content[MANIFEST] = manifest(text, build.platform, wheels).encode()
    content[LICENCE_LIST] = licence_list(wheels).encode()
    content |= {f"wheels/{wheel.file}": wheel.path.read_bytes() for wheel in wheels}
    values = tomllib.loads(text)
    path = out / f"{values['id']}-{values['version']}-{build.name}.zip"
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".building-", dir=out) as folder:
        beside = Path(folder, path.name)
        write_zip(beside, content)
        check_zip(beside, wheels)
        validate(beside)
        os.replace(beside, path)
    return path


def compare(build: Build, lock: Sequence[Wheel], out: Path) -> None:
    """Build once more elsewhere, and raise where the bytes are others."""
    with tempfile.TemporaryDirectory() as folder:
        again = make(build, lock, Path(folder))
        first = out / again.name
        if not first.is_file() or not filecmp.cmp(first, again, shallow=False):
            raise PackageError(f"{first} is not what another build gives")
    print(f"{first.name:45} the same when built again", flush=True)


def main() -> int:
    """Build what is asked for, and say how large it is; or build again, and say whether it is the same."""
    parser = argparse.ArgumentParser(prog="make package", description="Build the zips that users install")
    names = [build.name for build in BUILDS]
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="builds; default: all")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zips")
    parser.add_argument("--check", action="store_true", help="compare another build with what is there")
    options = parser.parse_args()
    try:
        lock = read_lock()
        for build in (build for build in BUILDS if build.name in options.only):
            if options.check:
                compare(build, lock, options.out)
                continue
            path = make(build, lock, options.out)
            size = path.stat().st_size / 1e6
            print(f"{path.name:45} {size:6.1f} MB  sha256 {digest(path)}", flush=True)
    except PackageError as error:
        print(f"make package: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
