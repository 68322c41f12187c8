# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line as a program that Ctrl-C ends: one line, and nothing is written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from clicases import ball

from femors_addon import meshfiles

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.skipif(os.name == "nt", reason="signals are sent otherwise on Windows")
def test_interrupted_program_leaves_nothing(tmp_path):
    meshfiles.write(tmp_path / "a.stl", ball(150, 150, (30, 24, 60)))
    meshfiles.write(tmp_path / "b.stl", ball(160, 160, (35, 26, 64)))
    command = [sys.executable, "-m", "femors_addon", "morph", "a.stl", "b.stl", "-o", "out.stl"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    first = process.stderr.readline()
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert "%" in first
    assert process.returncode == 130, err
    assert out == ""
    assert err.splitlines()[-1] == "femors: interrupted; nothing is written"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.stl", "b.stl"]


INTERRUPTED_EARLY = """
import builtins, runpy

usual = builtins.__import__

def interrupted(name, *rest, **named):
    if name == "cli":
        raise KeyboardInterrupt
    return usual(name, *rest, **named)

builtins.__import__ = interrupted
runpy.run_module("femors_addon", run_name="__main__")
"""


def test_a_program_interrupted_while_it_reads_its_modules_says_so_in_one_line():
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    command = [sys.executable, "-c", INTERRUPTED_EARLY]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "femors: interrupted; nothing is written\n"
