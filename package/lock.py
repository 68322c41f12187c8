# SPDX-License-Identifier: GPL-3.0-or-later
"""``make lock``: fetch the wheels that targets.py names and write their hashes to the lock file.

Run it after a change of a version in targets.py, look at the difference, and commit it. What comes
from the index at that moment is what later builds insist on.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from packaging.utils import parse_wheel_filename

from .targets import BUILDS, CACHE, LICENCES, LOCK
from .wheels import PackageError, canonical, digest, keep, metadata, pip_download

HEAD = """\
# SPDX-License-Identifier: GPL-3.0-or-later
# Made by `make lock` from package/targets.py; do not edit. Every wheel that `make package` puts into a
# zip, unmodified: its hash, size, licence, the Python it is for, and the zips that it is in.
"""


def collect() -> dict[str, tuple[Path, set[str], set[str]]]:
    """Fetch everything; return each file's path, Pythons and builds."""
    found: dict[str, tuple[Path, set[str], set[str]]] = {}
    CACHE.mkdir(parents=True, exist_ok=True)
    for build in BUILDS:
        for python, packages in build.pythons.items():
            print(f"{build.name}, Python {python}", flush=True)
            lines = [f"{name}=={version}" for name, version in packages.items()]
            with tempfile.TemporaryDirectory(dir=CACHE) as folder:
                for path in pip_download(lines, build, python, Path(folder)):
                    place, pythons, builds = found.setdefault(path.name, (keep(path), set(), set()))
                    assert place.exists()
                    pythons.add(python)
                    builds.add(build.name)
    return found


def licence(path: Path, name: str) -> str:
    """Return a wheel's licence: what targets.py has, if the wheel itself says nothing else."""
    known, (said, _, texts) = LICENCES[name], metadata(path)
    if known.split("-")[0] not in said or not texts:
        raise PackageError(
            f"{path.name} says that its licence is {said!r}, not {known}, or has no text of it"
        )
    return known


def entry(path: Path, pythons: set[str], builds: set[str]) -> str:
    """Return a wheel's table in the lock."""
    name, version, _, tags = parse_wheel_filename(path.name)
    pure = all(tag.interpreter.startswith("py") and tag.platform == "any" for tag in tags)
    if not pure and len(pythons) != 1:
        raise PackageError(f"{path.name} came for several Pythons: {sorted(pythons)}")
    order = [build.name for build in BUILDS if build.name in builds]
    values = {
        "name": canonical(name),
        "version": str(version),
        "file": path.name,
        "sha256": digest(path),
        "licence": licence(path, canonical(name)),
        "python": "any" if pure else next(iter(pythons)),
    }
    lines = [f'{key} = "{value}"' for key, value in values.items()]
    lines.insert(4, f"bytes = {path.stat().st_size}")
    lines.append("builds = [" + ", ".join(f'"{name}"' for name in order) + "]")
    return "\n".join(["[[wheel]]", *lines]) + "\n"


def main() -> int:
    """Write the lock, whole or not at all."""
    try:
        found = collect()
        tables = [entry(*found[name]) for name in sorted(found, key=str.lower)]
    except PackageError as error:
        print(f"make lock: {error}", file=sys.stderr)
        return 1
    beside = LOCK.with_name(f".{LOCK.name}.{os.getpid()}")
    beside.write_text("\n".join([HEAD, *tables]))
    os.replace(beside, LOCK)
    print(f"{LOCK.name}: {len(tables)} wheels")
    return 0


if __name__ == "__main__":
    sys.exit(main())
