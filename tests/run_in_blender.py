# SPDX-License-Identifier: GPL-3.0-or-later
"""Run pytest inside a real Blender binary.

    BLENDER_USER_RESOURCES=$(mktemp -d) FEMORS_SITE=/path/to/site \\
        blender -b --factory-startup --python-exit-code 1 \\
        --python tests/run_in_blender.py -- tests/blender -q

Everything after ``--`` goes to pytest; without it, ``tests/blender`` is run. The exit code is that
of pytest (5, "no tests", included). ``BLENDER_USER_RESOURCES`` must name an existing folder: it
keeps the user's own preferences and extensions out.

With ``FEMORS_INSTALLED`` the package that is installed in ``BLENDER_USER_RESOURCES`` is tested, with the
checkout off the path; leave ``--factory-startup`` away then, which would switch it off. The script runs
in the Python of a bpy wheel as well, without Blender's options.

``FEMORS_SITE`` is a folder that is added to the end of ``sys.path``, for what this Blender's Python
has not: pytest, and SciPy and fast-simplification where the extension has not brought its own.
Make it with the Python tag of that Blender (3.11, 3.13 ...), without NumPy, which Blender has:

    pip install --target DIR --python-version 3.13 --only-binary=:all: --no-deps \\
        scipy fast-simplification pytest pluggy iniconfig packaging pygments hypothesis sortedcontainers
"""

from __future__ import annotations

import os
import sys
from pathlib import Path


def main() -> int:
    """Return pytest's exit code for the arguments after ``--``."""
    site = os.environ.get("FEMORS_SITE")
    if site:
        if not Path(site).is_dir():
            print(f"FEMORS_SITE: there is no folder {site}", file=sys.stderr)
            return 2
        sys.path.append(site)
    try:
        import pytest
    except ModuleNotFoundError:
        print(
            "pytest is missing in this Blender's Python: set FEMORS_SITE (see the head of this file)",
            file=sys.stderr,
        )
        return 2
    root = Path(__file__).resolve().parent.parent
    os.chdir(root)
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    # from the root, pytest would put the checkout on the path for its __init__.py
    options = ["-o", "pythonpath=", "--confcutdir", "tests"] if os.environ.get("FEMORS_INSTALLED") else []
    # the cache folder would be shared with the other Pythons that test this checkout
    return int(pytest.main([*(arguments or ["tests/blender"]), *options, "-p", "no:cacheprovider"]))


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.exit(code)
