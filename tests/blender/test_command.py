# SPDX-License-Identifier: GPL-3.0-or-later
"""``blender --command femors``."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from pathlib import Path

import bpy
import pytest
from checkout import INSTALLED

ROOT = Path(__file__).resolve().parents[2]
ENABLE = (
    "import bpy, addon_utils; assert addon_utils.enable('bl_ext.user_default.femors', default_set=True); "
    "bpy.ops.wm.save_userpref()"
)


@pytest.fixture()
def files(pair, tmp_path):
    """Source and target as STL, and a path for the result."""
    paths = [tmp_path / f"{item.name}.stl" for item in pair]
    for item, path in zip(pair, paths, strict=True):
        bpy.ops.object.select_all(action="DESELECT")
        item.select_set(True)
        bpy.ops.wm.stl_export(filepath=str(path), export_selected_objects=True)
    return [*map(str, paths), "-o", str(tmp_path / "out.stl")]


def test_it_morphs(files, part):
    assert part("operators.command").run(["morph", *files, "--quiet"]) == 0
    assert Path(files[-1]).stat().st_size == Path(files[0]).stat().st_size


def test_bad_input_is_one_line(part, capfd, tmp_path):
    code = part("operators.command").run(["morph", "absent.stl", "b.stl", "-o", str(tmp_path / "o.stl")])
    said = capfd.readouterr().err.strip()
    assert code == 2
    assert "absent.stl" in said and "Traceback" not in said and said.count("\n") == 0
    assert part("operators.command").run(["mroph"]) == 2
    said = capfd.readouterr().err.strip()
    assert "did you mean morph?" in said and said.count("\n") == 0


def test_it_runs_in_a_blender_of_its_own(files, tmp_path, part):
    if not bpy.app.binary_path:
        pytest.skip("needs a blender binary")
    environment, options = dict(os.environ), []
    if not INSTALLED:
        repository = tmp_path / "user" / "extensions" / "user_default"
        repository.mkdir(parents=True)
        (repository / "femors").symlink_to(ROOT)
        environment["BLENDER_USER_RESOURCES"] = str(tmp_path / "user")
        # Blender's Python looks at PYTHONPATH, which stands for the extension's wheels, only if asked to
        environment["PYTHONPATH"] = os.environ.get("FEMORS_SITE", "")
        options = ["--python-use-system-env"]

    def run(*arguments: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            [bpy.app.binary_path, *arguments],
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    if not INSTALLED:
        enabled = run("-b", "--factory-startup", "--python-exit-code", "1", "--python-expr", ENABLE)
        assert enabled.returncode == 0, enabled.stdout + enabled.stderr
    done = run(*options, "--command", "femors", "morph", *files, "--quiet")
    assert done.returncode == 0, done.stdout + done.stderr
    assert Path(files[-1]).stat().st_size == Path(files[0]).stat().st_size
    wrong = run(*options, "--command", "femors", "morph", "absent.stl", *files[1:])
    assert wrong.returncode == 2
    assert "absent.stl" in wrong.stderr and "Traceback" not in wrong.stderr
    # Ctrl-C, which Blender would keep for itself
    Path(files[-1]).unlink()
    bones, meshfiles = part("femors_addon.shapes").pair(20000, 20000), part("femors_addon.meshfiles")
    for path, bone in zip(files, (bones.source, bones.target), strict=False):
        meshfiles.write(path, meshfiles.MeshFile.of(bone))
    command = [bpy.app.binary_path, *options, "--command", "femors", "morph", *files]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        late = threading.Timer(120, process.kill)  # a line that never comes ends in the assertion
        late.start()
        try:
            while "%" not in (line := process.stderr.readline()):
                assert line, "it ended before it was interrupted"
            process.send_signal(signal.SIGINT)
            said = process.stderr.read()
            assert process.wait(60) == 130, said
        finally:
            late.cancel()
    assert "femors: interrupted; nothing is written" in said and not Path(files[-1]).exists()
