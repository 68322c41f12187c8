# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator `femors.report`: everything that is known of a result, as a page or as data.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

import json
import os
from pathlib import Path
from typing import Any, ClassVar

import bpy
from bpy_extras.io_utils import ExportHelper

from ..femors_addon.progress import FemorsError
from . import decks, dependencies, heat_values, transfer_report, viewport
from .lazy import np


def reported(item: bpy.types.Object | None) -> dict[str, Any]:
    """Return what was reported of an object: the figures of jobs, and its measured quality."""
    if item is None or item.type != "MESH":
        return {}
    out = json.loads(item.femors.report) if item.femors.report else {}
    if item.femors.quality:
        out["quality"] = json.loads(item.femors.quality)
    for scene in item.users_scene:
        removed = json.loads(scene.femors_overclosure.report or "{}")
        if item.name in [body.get("name") for body in removed.get("bodies", ())]:
            out["overclosure"] = removed
    return out


class FEMORS_OT_report(decks.DeckOperator, bpy.types.Operator, ExportHelper):
    """Write a page with pictures, plots and all figures of the active result; or its figures as data"""

    bl_idname = "femors.report"
    bl_label = "Write Report"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = ".html"
    check_extension = None  # the ending says the format

    filepath: bpy.props.StringProperty(
        name="File",
        description="The file to write; .html is a page that needs nothing else, .json and .csv are data",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    filter_glob: bpy.props.StringProperty(
        name="Filter", description="Which files are shown", default="*.html;*.json;*.csv", options={"HIDDEN"}
    )
    object: bpy.props.StringProperty(
        name="Object",
        description="Name of the object that is reported on; else the active one",
        options={"SKIP_SAVE", "HIDDEN"},
    )

    transfer: bpy.props.BoolProperty(
        name="Transfer",
        description="Report on the scene's last transfer, not on an object",
        options={"SKIP_SAVE", "HIDDEN"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The packages must be there."""
        message = dependencies.missing()
        if not message and hasattr(context, "femors_form") and not reported(context.object):
            message = "Select the result of a morph, or measure the quality of a mesh first"
        if message:
            cls.poll_message_set(message)
        return not message

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Propose a name; refuse before a path is asked for."""
        try:
            name, _ = self._subject(context)
        except FemorsError as error:
            return self.refused(str(error))
        if self.filepath:
            return self.execute(context)
        folder = os.path.dirname(bpy.data.filepath)
        self.filepath = os.path.join(folder, f"{bpy.path.clean_name(name)}.html")
        return ExportHelper.invoke(self, context, event)

    def _item(self, context: bpy.types.Context) -> bpy.types.Object:
        item = bpy.data.objects.get(self.object) if self.object else context.object
        if item is None:
            raise FemorsError("No object to report on: select the result of a morph")
        if not reported(item):
            raise FemorsError(
                f"There is nothing to report of '{item.name}': "
                "it is no result, and its quality was not measured"
            )
        return item

    def _subject(self, context: bpy.types.Context) -> tuple[str, bpy.types.Object | dict[str, Any]]:
        """Return what is reported on: its name, and the object or the transfer's figures."""
        if self.transfer:
            found = transfer_report.last(context)
            return f"Transfer by {found['objects']['field']}", found
        item = self._item(context)
        return item.name, item

    def run(self, context: bpy.types.Context) -> tuple[str, str]:
        """Collect pictures and figures, and write them."""
        from ..femors_addon.files import check_writable, replacing
        from ..femors_addon.report_files import check_ending, report_bytes

        if not self.filepath:
            raise FemorsError("No file named: pass filepath='<path>'")
        path = Path(bpy.path.abspath(self.filepath)).absolute()  # "//" is nowhere in an unsaved file
        check_ending(path)
        check_writable(path)
        name, subject = self._subject(context)
        pictures = viewport.picture(context) if path.suffix.lower() in (".html", ".htm") else None
        data = report_bytes(
            path,
            subject if isinstance(subject, dict) else reported(subject),
            name if self.transfer else f"Report on {name}",
            lambda: _figures(subject, pictures),
            {"Blender": bpy.app.version_string},
        )
        with replacing(path) as (new,):
            new.write_bytes(data)
        return "INFO", f"'{name}': report written to {path}"


def _figures(subject: bpy.types.Object | dict[str, Any], seen: bytes | None) -> list[Any]:
    """Return the sections with pictures, that of the viewport first."""
    from ..femors_addon.report_html import Figure, Section

    is_transfer = isinstance(subject, dict)
    sections = transfer_report.figures(subject, _surface) if is_transfer else _pictures(subject)
    if seen is not None:
        sections.insert(0, Section("Viewport", (Figure(seen, "As the viewport showed it."),)))
    return sections


def _pictures(item: bpy.types.Object) -> list[Any]:
    """Return the sections of an object: of the morph where it was one, else of the mesh."""
    from ..femors_addon.quantities import QUANTITIES
    from ..femors_addon.report_figures import mesh_figures, morph_figures
    from ..femors_addon.transforms import transformed

    report = reported(item)
    surface = _surface(item)
    values = {}
    for key, quantity in QUANTITIES.items():
        if not quantity.of_faces and quantity.attribute in item.data.attributes:
            values[key] = heat_values.values_of(item, key)
    target, source = (_named(report.get(key), item) for key in ("target", "source"))
    if "transform" in report:
        aligned = None
        if source is not None and len(source.data.vertices) == len(item.data.vertices):
            start = _surface(source)
            aligned = start.moved(transformed(np.array(report["transform"]), start.vertices))
        return morph_figures(aligned, surface, _surface(target) if target else None, values)
    other = _named(report.get("quality", {}).get("other_name"), item)
    return mesh_figures(surface, _surface(other) if other else None, values)


def _named(name: Any, item: bpy.types.Object) -> bpy.types.Object | None:
    """Return the mesh object of a name, as long as it is still there and another."""
    found = bpy.data.objects.get(name) if isinstance(name, str) and name else None
    return found if found is not None and found.type == "MESH" and found != item else None


def _surface(item: bpy.types.Object) -> Any:
    """Return an object's surface in world coordinates, with its shape keys at their values."""
    surface, _ = heat_values.surface_of(item)
    keys = item.data.shape_keys
    if keys is None:
        return surface
    seen = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    if len(seen.vertices) != len(item.data.vertices):
        return surface
    local = np.empty(3 * len(seen.vertices), dtype=np.float32)
    seen.vertices.foreach_get("co", local)
    matrix = np.array(item.matrix_world, dtype=np.float64)
    return surface.moved(local.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3])


classes = (FEMORS_OT_report,)
