# SPDX-License-Identifier: GPL-3.0-or-later
"""The manual: its links lead somewhere, its reference is made from the code and complete, its scripts run."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from docs.make import api, messages, pasted, settings
from docs.make.tables import cell, write
from femors_addon import cli
from femors_addon.settings import specs

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
MADE = ("reference/", "files/")
"""What `make docs` writes below docs/."""
WRITTEN = [path for path in sorted(DOCS.rglob("*.md")) if path.relative_to(DOCS).parts[0] != "reference"]
PAGES = [*WRITTEN, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
"""For Python in a process of its own, also where this one runs inside Blender."""


def wheel() -> bool:
    """Whether this Python has Blender as a package, and not Blender this Python."""
    try:
        importlib.metadata.version("bpy")
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def anchors(path: Path) -> set[str]:
    """Return the anchors of a page's headlines, as MkDocs and GitHub both make them of plain words."""
    heads = re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def links(text: str) -> Iterator[str]:
    """Give the targets of links and pictures; code is not looked at."""
    text = re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)
    yield from re.findall(r"\]\(([^)\s]+)\)", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    for link in links(page.read_text(encoding="utf-8")):
        if link.startswith(("http://", "https://", "#")):
            continue
        name, _, anchor = link.partition("#")
        path = (page.parent / name).resolve()
        if DOCS in path.parents and path.relative_to(DOCS).as_posix().startswith(MADE):
            continue  # made by docs.make; `mkdocs --strict` looks at it
        assert path.exists(), f"{page.name}: {link}"
        assert not anchor or anchor in anchors(path), f"{page.name}: {link}"


def nav(text: str) -> list[str]:
    """Return the pages of mkdocs.yml's navigation."""
    return re.findall(r":\s+(\S+\.md)\s*$", text.partition("\nnav:")[2], re.MULTILINE)


def test_the_navigation_has_every_page():
    listed = nav((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert len(listed) == len(set(listed))
    written = {path.relative_to(DOCS).as_posix() for path in WRITTEN}
    assert {page for page in listed if not page.startswith("reference/")} == written


def test_pictures_are_small_and_used():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    pictures = sorted((DOCS / "images").glob("*.png"))
    for path in pictures:
        assert f"images/{path.name}" in text, f"{path.name} is on no page"
        assert path.stat().st_size < (200_000 if path.name != "demo.png" else 300_000), path.name
    assert sum(path.stat().st_size for path in pictures) < 2_000_000


# --- the reference ----------------------------------------------------------------------------------
def test_every_subcommand_and_option_is_named_with_its_help():
    page = settings.command_page()
    parser = cli._parser("femors")
    for command in cli.COMMANDS:
        assert f"## femors {command.name}" in page
        own = page.partition(f"## femors {command.name}\n")[2].partition("\n## femors ")[0]
        for action in settings.subparser(parser, command.name)._actions:
            for flag in action.option_strings:
                assert flag in own, f"{command.name} {flag}"
            if not action.option_strings:
                assert str(action.metavar or action.dest) in own
            if action.help and "%" not in action.help and action.help != argparse.SUPPRESS:
                assert cell(action.help) in own, f"{command.name} {action.dest}"
        for code in re.findall(r"^  (\d+)  ", command.exit_codes, re.MULTILINE):
            assert f"| `{code}` |" in own


def test_every_setting_is_named_with_default_and_help():
    page = settings.settings_page()
    names = {path.stem for path in (ROOT / "femors_addon").glob("*settings.py")} - {"settings"}
    classes = settings.settings_classes()
    assert {cls.__module__.rpartition(".")[2] for cls in classes} == names
    for cls in classes:
        own = page.partition(f"## {cls.__name__}\n")[2].partition("\n## ")[0]
        for name, (_, spec) in specs(cls).items():
            row = next(line for line in own.splitlines() if f"| `{name}` |" in line)
            assert cell(spec.help) in row and cell(spec.label) in row
            assert all(f"`{value}`" in row for value, _, _ in spec.choices)


def test_the_page_follows_the_code(monkeypatch):
    """A help text that changes in the code changes on the page: nothing is typed twice."""
    command = cli.COMMANDS[0]._replace(help="Quite another thing.")
    monkeypatch.setattr(cli, "COMMANDS", (command, *cli.COMMANDS[1:]))
    assert "Quite another thing." in settings.command_page()


def test_every_message_is_collected():
    """As many as a plain search finds calls with a text, module by module."""
    found = messages.collected(ROOT)
    for path in sorted((ROOT / "femors_addon").glob("*.py")):
        text = path.read_text(encoding="utf-8")
        calls = re.findall(r'raise FemorsError\(\s*f?"((?:[^"\\]|\\.)*)"', text)
        known = "\n".join(found.get(f"femors_addon/{path.name}", []))
        for call in calls:
            plain = max(re.split(r"\{[^}]*\}", call), key=len).replace('\\"', '"')
            if sum(c.isalpha() for c in re.sub(r"\{[^}]*\}", "", call)) > 4:
                assert plain in known, f"{path.name}: {call}"


def test_troubleshooting_quotes_what_the_code_says():
    """Each headline's words stand in the code: in a message, a warning or a label."""
    sources = [p for room in ("femors_addon", "operators", "ui") for p in (ROOT / room).rglob("*.py")]
    said = " ".join(re.sub(r'"\s*\n\s*f?"', "", path.read_text(encoding="utf-8")) for path in sources)
    counted = r"\{counted\([^{}]*?, '([^']*)'(?:, '([^']*)')?\)\}"  # the manual has the plural
    said = re.sub(counted, lambda found: found[2] or found[1] + "s", said)
    ours = ("The result flickers", "Nothing is to be seen")
    page = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    heads = re.findall(r"^### (.+)$", page, re.MULTILINE)
    assert len(heads) > 20
    for head in heads:
        if not head.startswith(ours):
            for words in re.split(r"…|'", head):
                assert words.strip() in said, head


def test_every_public_module_and_name_has_a_docstring():
    import ast

    for name in api.PUBLIC:
        path = ROOT / "femors_addon" / f"{name}.py"
        assert path.exists(), f"{name}: take it out of docs/make/api.py"
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                assert ast.get_docstring(node), f"{name}.{node.name}"


@pytest.mark.skipif(not wheel(), reason="needs the bpy wheel of .venv")
def test_every_operator_panel_and_form_of_blender_is_named(tmp_path):
    code = (
        "import sys; from docs.make.blender import blender_page; open(sys.argv[1], 'w').write(blender_page())"
    )
    out = tmp_path / "blender.md"
    environment = {k: v for k, v in ENVIRONMENT.items() if k != "BLENDER_USER_RESOURCES"}
    subprocess.run([sys.executable, "-c", code, str(out)], cwd=ROOT, env=environment, check=True, timeout=300)
    page = out.read_text(encoding="utf-8")
    sources = {p: p.read_text(encoding="utf-8") for r in ("operators", "ui") for p in (ROOT / r).glob("*.py")}
    text = "\n".join(sources.values())
    operators = set(re.findall(r'bl_idname = "femors\.(\w+)"', text))
    operators |= set(re.findall(r"^class FEMORS_OT_(\w+)\(", text, re.MULTILINE))
    assert len(operators) >= 12
    for name in operators:
        assert f"### femors.{name}\n" in page, name
    for name in re.findall(r"^class (FEMORS_P[TG]_\w+)\(", text, re.MULTILINE):
        assert name in page, name
    for cls in settings.settings_classes():
        for name, (_, spec) in specs(cls).items():
            assert f"| `{name}` | {cell(spec.label)} |" in page, f"{cls.__name__}.{name}"


def test_a_cell_is_one_line_and_plain():
    assert cell("a | b\n  *c* <d> `x|y` ``z``") == r"a \| b \*c\* \<d\> `x&#124;y` `z`"
    assert cell("it`s") == "it's"


def test_a_page_that_says_the_same_is_not_written_again(tmp_path):
    path = write(tmp_path / "a.md", "A", "text")
    os.utime(path, (1, 1))
    write(path, "A", "text")
    assert path.stat().st_mtime == 1


# --- the tutorials ----------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def tutorial(tmp_path_factory) -> Path:
    """The tutorials' files."""
    folder = tmp_path_factory.mktemp("tutorial")
    command = [sys.executable, str(ROOT / "demo" / "tutorial.py"), str(folder)]
    subprocess.run(command, env=ENVIRONMENT, check=True)
    return folder


def blocks(page: str, kind: str = "") -> list[str]:
    """Return a page's blocks of code of a kind."""
    return re.findall(rf"^```{kind}\n(.*?)^```", (DOCS / page).read_text("utf-8"), re.MULTILINE | re.DOTALL)


def test_the_commands_of_the_tutorials_run_and_say_what_is_pasted(tutorial, monkeypatch):
    """One after the other, as a reader does it; numbers may differ in their last digits elsewhere."""
    monkeypatch.chdir(tutorial)
    said = {}
    for page in pasted.TUTORIALS:
        lines = pasted.commands((DOCS / page).read_text(encoding="utf-8"))
        assert lines, page
        for words in lines:
            code, out, err = pasted.run(words)
            assert code == int("--check" in words), (words, err)  # the knee overlaps
            said.setdefault(page, []).append(out)
    for page, texts in said.items():
        heads = {pasted.shape(line) for text in texts for line in text.splitlines()}
        for block in blocks(page, "text"):
            for line in block.splitlines():
                if re.match(
                    r"(surface, |scaled|edge|XOR|volume|knee_\w+ - |CERTIFIED|\w+\.(stl|csv|inp): )",
                    line.strip(),
                ):
                    assert pasted.shape(line) in heads, line


def test_pasted_lines_are_brought_up_to_date_and_prose_is_pointed_out():
    page = "In all 0.144 mm, or 5 %.\n\n```text\nfit   0.144 [0.1, 2]\nfit   0.2 [0, 1]\nother 7\n```\nend\n"
    new = pasted.refreshed(page, ["fit   0.1455 [0.1, 2]", "fit 3 [0, 1]", "more 8"])
    assert new == page.replace("fit   0.144", "fit   0.1455").replace("fit   0.2", "fit 3")
    assert pasted.gone(page, new) == ["In all 0.144 mm, or 5 %."]
    assert pasted.gone(page, page) == []


def test_the_python_page_runs(tutorial, monkeypatch):
    from femors_addon.progress import Cancelled

    monkeypatch.chdir(tutorial)
    space: dict = {}
    for block in blocks("howto/python.md", "python"):
        try:
            exec(compile(block, "python.md", "exec"), space)
        except Cancelled:
            assert "raises Cancelled" in block
    assert (tutorial / "out.inp").exists() and space["result"].surface.converged


# --- the environment that builds it -----------------------------------------------------------------
STAND_IN = """#!/bin/sh
case "$*" in
*"-m venv"*) mkdir -p "$3/bin"; cp "$0" "$3/bin/python" ;;
*"-m pip"*) sleep 0.3; touch "$(dirname "$0")/../installed" ;;
*) exec {python} "$@" ;;
esac
"""


@pytest.mark.skipif(os.name != "posix", reason="a shell script")
def test_two_environments_made_at_once_do_not_break_each_other(tmp_path):
    python = tmp_path / "python"
    python.write_text(STAND_IN.format(python=sys.executable))
    python.chmod(0o755)
    place = tmp_path / "cache" / "docs"
    (place / "bin").mkdir(parents=True)  # one that was interrupted: without its mark
    command = [ROOT / "requirements" / "make_tools.sh", place, "requirements.txt", python]
    made = [subprocess.Popen([str(word) for word in command]) for _ in range(3)]
    assert [one.wait() for one in made] == [0, 0, 0]
    assert (place / "installed").exists() and (place / ".made").exists()
    assert sorted(path.name for path in place.parent.iterdir()) == ["docs"]
    before = place.stat().st_ino
    assert subprocess.run([str(word) for word in command], check=True, capture_output=True).stdout == b""
    assert place.stat().st_ino == before
