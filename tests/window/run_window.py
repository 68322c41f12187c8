#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Run ``story.py`` in a real Blender window under Xvfb.

    run-trixie python3 tests/window/run_window.py [--out DIR] [--zip ZIP | --site DIR] [--blender blender]

Needs Xvfb, xdotool and scrot beside Blender (`run-trixie` of get-blender.sh has them); where one is
missing it says "skipped" and ends with exit code 5, like pytest without tests. ``--zip`` is a package,
which is installed as a user installs it, and nothing else is on the path; without one this checkout is
shown, and ``--site`` is the folder with SciPy and fast-simplification for that Blender's Python.
Screenshots, Blender's output and ``result.json`` are written to ``--out``. Exit code 0 when every step held.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO

HERE = Path(__file__).resolve().parent
SIZE = (1280, 800)
SKIPPED = 5


def start_display() -> tuple[subprocess.Popen, str]:
    """Start an X server on a free display; return it and the display's name."""
    read, write = os.pipe()
    command = [
        "Xvfb",
        "-displayfd",
        str(write),
        "-screen",
        "0",
        f"{SIZE[0]}x{SIZE[1]}x24",
        "-nolisten",
        "tcp",
    ]
    server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    if not number:
        raise SystemExit("Xvfb did not start")
    return server, f":{number}"


def install(blender: str, package: Path, environment: dict[str, str], log: IO[str]) -> None:
    """Install and enable a zip in the preferences that the environment names."""
    command = [blender, "--command", "extension", "install-file", "-r", "user_default", "-e", str(package)]
    done = subprocess.run(
        command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=False
    )
    if done.returncode:
        raise SystemExit(f"{package} was not installed: see the log")


def run(options: argparse.Namespace) -> int:
    """Run the story; return 0 when it held to its end and Blender quit by itself."""
    out, package, blender, limit = options.out, options.zip, options.blender, options.limit
    out.mkdir(parents=True, exist_ok=True)
    for old in (*out.glob("*.png"), *out.glob("*.txt"), out / "result.json"):
        old.unlink(missing_ok=True)
    result = out / "result.json"
    server, display = start_display()
    with (
        tempfile.TemporaryDirectory(prefix="femors_window_") as resources,
        open(out / "blender.log", "w") as log,
    ):
        environment = os.environ | {
            "DISPLAY": display,
            "BLENDER_USER_RESOURCES": resources,
            "TMPDIR": resources,  # where Blender writes its quit.blend
            "FEMORS_SITE": options.site,
            "FEMORS_WINDOW_OUT": str(out.resolve()),
            "FEMORS_WINDOW_STEPS": options.steps,
            "FEMORS_WINDOW_WITHOUT": options.without,
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        command = [blender, "--factory-startup"]
        if package is not None:  # factory settings would switch it off
            environment = {k: v for k, v in environment.items() if k not in ("PYTHONPATH", "FEMORS_SITE")}
            environment["FEMORS_INSTALLED"] = "1"
            install(blender, package.resolve(), environment, log)
            command = [blender]
        command += ["--window-geometry", "0", "0", *map(str, SIZE), "--python", str(HERE / "story.py")]
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)
        try:
            code = process.wait(limit)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            code = f"none after {limit:.0f} s"
        finally:
            server.terminate()
            server.wait()
        for crash in Path(resources).glob("*.crash.txt"):  # where Blender was when it crashed
            shutil.copy(crash, out)
    seen = (
        json.loads(result.read_text()) if result.exists() else {"error": "Blender ended before the story did"}
    )
    print(json.dumps(seen, indent=1))
    if seen.get("error") or code != 0:
        print(
            f"failed: {seen.get('error')}; Blender's exit code: {code}; see {out}/blender.log",
            file=sys.stderr,
        )
        return 1
    print(f"held; screenshots in {out}")
    return 0


def main() -> int:
    """Read the arguments and run."""
    parser = argparse.ArgumentParser(description="A morph in a real Blender window, with screenshots")
    parser.add_argument("--out", type=Path, default=Path("test_output/window"))
    parser.add_argument("--zip", type=Path, help="the package to install")
    parser.add_argument("--site", default=os.environ.get("FEMORS_SITE", ""))
    parser.add_argument("--blender", default="blender")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds for the whole run")
    parser.add_argument("--steps", default="", help="only these steps, with commas; all where left out")
    parser.add_argument("--without", default="", help="all but these steps, with commas")
    options = parser.parse_args()
    missing = [name for name in (options.blender, "Xvfb", "xdotool", "scrot") if shutil.which(name) is None]
    if missing:
        print(f"skipped: there is no {', no '.join(missing)}")
        return SKIPPED
    start = time.monotonic()
    code = run(options)
    print(f"{time.monotonic() - start:.0f} s")
    return code


if __name__ == "__main__":
    sys.exit(main())
