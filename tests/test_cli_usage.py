# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: help, wrong options, what was probably meant, and progress."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from commands import Terminal, refused, run

from femors_addon import cli_morph, commandline, settings
from femors_addon.morph_settings import MorphSettings

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture()
def no_morph(monkeypatch):
    """Make the computation a failure: what is refused must be refused before it."""

    def never(*args, **kwargs):
        raise AssertionError("the morph was started")

    monkeypatch.setattr(cli_morph, "morph", never)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ([], "a command is needed: morph"),
        (["morf"], "invalid choice: 'morf'"),
        (["morph", "a.stl"], "required: TARGET, -o/--out"),
        (["morph", "a.stl", "b.stl", "-o", "c.stl", "--align", "maybe"], "invalid choice: 'maybe'"),
        (
            ["morph", "a.stl", "b.stl", "-o", "c.stl", "--levels", "many"],
            "--levels: invalid int value: 'many'",
        ),
        (["morph", "a.stl", "b.stl", "-o", "c.stl", "--levels", "-1"], "--levels: -1 is outside"),
        (
            ["morph", "a.stl", "b.stl", "-o", "c.stl", "--spread-start", "nan"],
            "--spread-start: nan is outside",
        ),
        (["morph", "a.stl", "b.stl", "-o", "c.stl", "--nonsense"], "--nonsense"),
        (["morph", "a.stl", "b.stl", "-o", "c.stl", "--quie"], "--quie"),
    ],
)
def test_usage_errors_are_one_line(capsys, no_morph, argv, words):
    assert words in refused(capsys, *argv)


def test_a_typing_error_points_to_the_help_of_its_command(capsys, no_morph):
    said = refused(capsys, "morph", "a.stl", "b.stl", "-o", "c.stl", "--quite")
    assert said == (
        "femors: unrecognized arguments: --quite; did you mean --quiet? (see 'femors morph --help')\n"
    )
    assert "(see 'femors --help')" in refused(capsys, "--quite")


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (
            ["morph", "a.stl", "b.stl", "--ou", "c.stl"],
            "--ou; did you mean --out? (see 'femors morph --help')",
        ),
        (["morph", "a.stl", "b.stl", "-out", "c.stl"], "-out; did you mean --out?"),
        (["morph", "a.stl", "b.stl", "-o", "c.stl", "--spraed-start=5"], "did you mean --spread-start?"),
        (["morph", "a.stl", "b.stl", "-o", "c.stl", "--fix-unit"], "--fix-unit; did you mean --fix-units?"),
        (["morph", "a.stl", "b.stl", "-o", "c.stl", "--align", "affin"], "'affin'; did you mean affine?"),
        (["overclosure", "a.stl", "b.stl", "--chek"], "--chek; did you mean --check?"),
        (["mroph", "a.stl", "b.stl", "--report", "r.html"], "'mroph'; did you mean morph?"),
        (["Transfer"], "did you mean transfer?"),
        (["zzz"], "'zzz'; choose from morph, convert, quality,"),
        (["--verison"], "--verison; did you mean --version? (see 'femors --help')"),
    ],
)
def test_what_was_probably_meant(capsys, no_morph, argv, words):
    assert words in refused(capsys, *argv)


def test_nothing_far_fetched_is_meant(capsys, no_morph):
    for argv in (
        ["morph", "a.stl", "b.stl", "-o", "c.stl", "--zzzzz"],
        ["morph", "a.stl", "-3", "-o", "c.stl", "x"],
    ):
        assert "did you mean" not in refused(capsys, *argv)


@pytest.mark.parametrize("argv", [["--help"], ["morph", "--help"], ["--version"]])
def test_help_and_version_end_well(capsys, argv):
    code, out, err = run(capsys, *argv)
    assert (code, err) == (0, "")
    assert out


def test_help_names_every_setting_and_exit_code(capsys):
    _, out, _ = run(capsys, "morph", "--help")
    for name in settings.specs(MorphSettings):
        assert f"--{name.replace('_', '-')}" in out
    assert "--align" in out
    assert "advanced:" in out
    assert "exit codes:" in out


def test_version_is_that_of_the_manifest(capsys):
    _, out, _ = run(capsys, "--version")
    assert f'version = "{out.split()[1]}"' in (ROOT / "blender_manifest.toml").read_text()


def test_progress_rewrites_one_line_of_a_terminal():
    err = Terminal()
    console = commandline.Console(err=err)
    console.progress(0.1, "a long text")
    console.progress(0.2, "short")
    console.warn("done")
    assert "\n" not in err.getvalue()[: -len("femors: done\n")]
    assert err.getvalue().endswith("\rfemors: done\n")
    lines = err.getvalue().split("\r")
    assert len(lines[2]) == len(lines[1])  # the shorter text hides the longer one


@pytest.mark.parametrize(("seconds", "lines"), [(0.5, 0), (3.0, 2), (1000.0, 10)])
def test_progress_elsewhere_is_sparse(monkeypatch, seconds, lines):
    now = [0.0]
    monkeypatch.setattr(commandline.time, "monotonic", lambda: now[0])
    err = io.StringIO()
    console = commandline.Console(err=err)
    for i in range(1001):
        now[0] = seconds * i / 1000
        console.progress(i / 1000, f"step {i}")
    written = err.getvalue().splitlines()
    assert len(written) == lines
    assert lines < 10 or written[0] == " 10 %  step 100"
