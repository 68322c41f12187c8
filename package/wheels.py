# SPDX-License-Identifier: GPL-3.0-or-later
"""Wheels: the lock that names them, and their way here through pip."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from email.parser import Parser
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename

from .targets import CACHE, LOCK, Build


@dataclass(frozen=True)
class Wheel:
    """A line of the lock: a file, its content's hash, and which builds it belongs to, for which Python."""

    name: str
    version: str
    file: str
    sha256: str
    bytes: int
    licence: str
    python: str
    builds: tuple[str, ...]

    @property
    def path(self) -> Path:
        """Where it is kept."""
        return CACHE / self.file


class PackageError(Exception):
    """A package that must not be built: one line that says why."""


def read_lock(path: Path = LOCK) -> tuple[Wheel, ...]:
    """Return the lock's wheels, in the order of the file."""
    entries = tomllib.loads(path.read_text())["wheel"]
    return tuple(Wheel(**{**entry, "builds": tuple(entry["builds"])}) for entry in entries)


def digest(path: Path) -> str:
    """Return a file's SHA-256 in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def intact(wheel: Wheel) -> bool:
    """Say whether the wheel is here, and is the one that the lock means."""
    return (
        wheel.path.is_file()
        and wheel.path.stat().st_size == wheel.bytes
        and digest(wheel.path) == wheel.sha256
    )


def pip_download(requirements: Iterable[str], build: Build, python: str, folder: Path) -> list[Path]:
    """Let pip fetch wheels for another platform and Python; return the files.

    Parameters
    ----------
    requirements : iterable of str
        Lines of a requirements file; all must have a hash if one has.
    folder : Path
        Where the files go; new or empty.
    """
    lines = list(requirements)
    listed = folder / "requirements.txt"
    listed.write_text("\n".join(lines) + "\n")
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--disable-pip-version-check",
        "--no-input",
    ]
    command += ["--retries", "10", "--no-deps", "--only-binary=:all:", "--implementation", "cp"]
    command += ["--python-version", python, "--dest", str(folder), "--requirement", str(listed)]
    for tag in build.tags:
        command += ["--platform", tag]
    if subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode != 0:
        raise PackageError(
            f"pip could not fetch the wheels of {build.name} for Python {python}; it says why above"
        )
    listed.unlink()
    return sorted(folder.iterdir())


def keep(path: Path) -> Path:
    """Move a fetched file into the cache, whole or not at all."""
    place = CACHE / path.name
    os.replace(path, place)
    return place


def fetch(wheels: Iterable[Wheel], build: Build) -> None:
    """See that the wheels of a build are in the cache, and that they are what the lock says."""
    CACHE.mkdir(parents=True, exist_ok=True)
    absent = [wheel for wheel in wheels if not intact(wheel)]
    for python in build.pythons:
        wanted = [wheel for wheel in absent if wheel.python in (python, "any") and not intact(wheel)]
        if not wanted:
            continue
        lines = [f"{wheel.name}=={wheel.version} --hash=sha256:{wheel.sha256}" for wheel in wanted]
        with tempfile.TemporaryDirectory(dir=CACHE) as folder:
            for path in pip_download(lines, build, python, Path(folder)):
                keep(path)
    for wheel in absent:
        if not intact(wheel):
            raise PackageError(f"{wheel.file} is not what {LOCK.name} says, or was not fetched")


def metadata(path: Path) -> tuple[str, list[Requirement], list[str]]:
    """Return what a wheel says of itself: its licence, what it requires, and its licence files."""
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        (inner,) = [name for name in names if re.fullmatch(r"[^/]+\.dist-info/METADATA", name)]
        message = Parser().parsestr(archive.read(inner).decode())
    said = message.get("License-Expression") or ""
    if not said:
        kinds = [c for c in message.get_all("Classifier", []) if c.startswith("License :: OSI Approved ::")]
        first = (message.get("License") or "").strip().split("\n")[0]
        said = kinds[0].rpartition(" :: ")[2] if kinds else first
    required = [Requirement(text) for text in message.get_all("Requires-Dist", [])]
    texts = [
        n for n in names if re.search(r"(licen[sc]e|copying)[^/]*$", n, re.IGNORECASE) and ".py" not in n
    ]
    return said, required, texts


def requires(path: Path, python: str) -> list[Requirement]:
    """Return what a wheel requires in a Python, extras left out."""
    environment = {"python_version": python, "python_full_version": python + ".0", "extra": ""}
    return [item for item in metadata(path)[1] if item.marker is None or item.marker.evaluate(environment)]


def fits(file: str, build: Build, python: str) -> bool:
    """Say by a wheel's name whether it is for a build's platform, and for a Python ("any": for all)."""
    platform = {
        "linux-x64": r"manylinux\w*_x86_64",
        "windows-x64": "win_amd64",
        "macos-arm64": r"macosx_\w+_arm64",
        "macos-x64": r"macosx_\w+_x86_64",
    }[build.platform]
    tags = parse_wheel_filename(file)[3]
    if python == "any":
        return any(tag.interpreter == "py3" and tag.platform == "any" for tag in tags)
    ours = "cp" + python.replace(".", "")
    return all(
        (tag.interpreter, tag.abi) == (ours, ours) and re.fullmatch(platform, tag.platform) for tag in tags
    )


def canonical(name: str) -> str:
    """Return a package's name as the index knows it."""
    return str(canonicalize_name(name))
