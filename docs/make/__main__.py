# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the generated pages of the manual.

    .venv/bin/python -m docs.make [--out docs]

Into ``reference/``: the command line, settings, Blender's side, messages, the Python API, changes; into
``files/``: the files of the tutorials. They are not committed, so that they cannot be out of date.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import zipfile
from pathlib import Path

from . import api, messages, settings
from .tables import write

ROOT = Path(__file__).resolve().parents[2]


def pages(out: Path) -> list[Path]:
    """Write all pages; return their paths."""
    folder = out / "reference"
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").partition("\n")[2]
    made = [
        write(folder / "command-line.md", "Command line", settings.command_page()),
        write(folder / "settings.md", "Settings", settings.settings_page()),
        write(folder / "messages.md", "Messages", messages.messages_page(ROOT)),
        write(folder / "api.md", "Python API", api.api_page(ROOT)),
        write(folder / "changes.md", "Changes", changes),
    ]
    from .blender import blender_page

    made.append(write(folder / "blender.md", "In Blender", blender_page()))
    return made


def tutorial_files(path: Path) -> Path:
    """Write the zip of the tutorials' files."""
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = path.parent / "tutorial"
    subprocess.run(
        [sys.executable, str(ROOT / "demo" / "tutorial.py"), str(folder)],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted(folder.iterdir()):
            packed.write(file, f"tutorial/{file.name}")
            file.unlink()
    folder.rmdir()
    return path


def main() -> int:
    """Write everything and say what."""
    parser = argparse.ArgumentParser(prog="python -m docs.make", description="Write the generated pages")
    parser.add_argument("--out", type=Path, default=ROOT / "docs")
    parser.add_argument("--no-files", action="store_true", help="leave the tutorials' files out")
    options = parser.parse_args()
    made = [] if options.no_files else [tutorial_files(options.out / "files" / "tutorial.zip")]
    for path in [*made, *pages(options.out)]:
        print(f"{os.path.relpath(path)}  ({path.stat().st_size / 1024:.0f} kB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
