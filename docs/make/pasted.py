# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tutorials paste of the command line's words: their commands run, their blocks brought up to date.

    .venv/bin/python -m docs.make.pasted

Runs the commands of each page on the files of ``demo/tutorial.py``, in a folder of its own, and writes the
numbers that they give now into the page's ``text`` blocks. Prose is left to its author: the lines that
name a number which has changed are listed.
"""

from __future__ import annotations

import contextlib
import difflib
import io
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
TUTORIALS = [*(f"tutorials/{name}.md" for name in ("bone", "deck", "sites", "knee")), "quality.md"]
"""The pages whose commands build on one another's files, in their order."""
NUMBER = re.compile(r"[-+]?\d[\d.e+-]*")
BLOCK = re.compile(r"^```text\n(.*?)^```", re.MULTILINE | re.DOTALL)


def commands(text: str) -> list[list[str]]:
    """Return the indented commands of a page that begin with femors, as words."""
    found = re.findall(r"^    femors (.+)$", text.replace("\\\n", " "), re.MULTILINE)
    return [line.split() for line in found]


def run(words: Iterable[str]) -> tuple[int, str, str]:
    """Run a command in the working folder; return its exit code and what it said."""
    from femors_addon import cli

    argv = [name for word in words for name in _expanded(word)]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        code = cli.main(argv)
    return code, out.getvalue(), err.getvalue()


def _expanded(word: str) -> list[str]:
    return sorted(path.name for path in Path().glob(word)) if "*" in word else [word]


def shape(line: str) -> str:
    """Return a line without its numbers and blanks."""
    return NUMBER.sub("#", " ".join(line.split()))


def refreshed(text: str, said: Sequence[str]) -> str:
    """Return a page with the lines of its blocks as they are said now; what is said nowhere stays."""
    now = [shape(line) for line in said]

    def block(found: re.Match[str]) -> str:
        lines = found[1].splitlines()
        alike = difflib.SequenceMatcher(None, [shape(line) for line in lines], now, autojunk=False)
        for here, there, count in alike.get_matching_blocks():  # the longest stretch first
            lines[here : here + count] = said[there : there + count]
        return "\n".join(["```text", *lines, "```"])

    return BLOCK.sub(block, text)


def gone(old: str, new: str) -> list[str]:
    """Return the lines of prose that name a number which no block of the page has any more."""
    before, after = (_numbers("\n".join(BLOCK.findall(text))) for text in (old, new))
    lost = {number for number in before - after if len(number) > 2}
    return [line for line in BLOCK.sub("", new).splitlines() if lost & _numbers(line)]


def _numbers(text: str) -> set[str]:
    return {number.strip("+-.") for number in NUMBER.findall(text)}


def main() -> int:
    """Bring all pages up to date."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, str(DOCS.parent / "demo" / "tutorial.py"), folder], check=True)
        os.chdir(folder)
        for name in TUTORIALS:
            page = DOCS / name
            old = page.read_text(encoding="utf-8")
            said: list[str] = []
            for words in commands(old):
                before = set(Path().glob("*.csv"))
                _, out, err = run(words)
                written = sorted(set(Path().glob("*.csv")) - before)
                said += [*out.splitlines(), *err.splitlines()]
                for path in written:
                    said += path.read_text(encoding="utf-8").splitlines()
            new = refreshed(old, said)
            page.write_text(new, encoding="utf-8")
            changed = sum(one != two for one, two in zip(old.splitlines(), new.splitlines(), strict=True))
            print(f"{name}: {changed} lines changed")
            for line in gone(old, new):
                print(f"    look at: {line}")
        os.chdir(here)
    return 0


if __name__ == "__main__":
    sys.exit(main())
