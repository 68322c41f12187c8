# SPDX-License-Identifier: GPL-3.0-or-later
"""How tests call the command line."""

from __future__ import annotations

import io
import re

from femors_addon import cli


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def run(capsys, *argv: object) -> tuple[int, str, str]:
    """Return the exit code and what was said on stdout and stderr."""
    code = cli.main([str(word) for word in argv])
    said = capsys.readouterr()
    return code, said.out, said.err


def told(err: str) -> str:
    """Return what stderr says beside how far a job is: lines that come after a second, on a busy machine."""
    return re.sub(r"(?m)^ *\d+ %  .*\n", "", err)


def refused(capsys, *argv: object) -> str:
    """Assert exit code 2 with one line on stderr, which is returned."""
    code, out, err = run(capsys, *argv)
    err = told(err)
    assert (code, out) == (2, "")
    assert err.startswith("femors: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    return err
