# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators `femors.import_landmarks` and `femors.export_landmarks`.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

import os
from typing import Any, ClassVar

import bpy
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..femors_addon.progress import FemorsError, counted
from ..femors_addon.transfer_settings import AxesSettings
from . import marks, scene
from .decks import DeckOperator, ObjectMaker
from .lazy import np
from .props import ARGUMENT, add_properties, setting_properties

ENDINGS = (".mrk.json", ".json", ".fcsv", ".csv")
"""Those of `femors_addon.landmarkfiles`; a test compares them."""
GLOB = ";".join(f"*{ending}" for ending in ENDINGS)


@add_properties(setting_properties(AxesSettings, flags=ARGUMENT))
class FEMORS_OT_import_landmarks(ObjectMaker, bpy.types.Operator, ImportHelper):
    """Read landmarks from a CSV file or one of 3D Slicer: an empty for each, in a collection"""

    bl_idname = "femors.import_landmarks"
    bl_label = "Import Landmarks"
    bl_options: ClassVar[set[str]] = {"UNDO"}

    filepath: bpy.props.StringProperty(
        name="File", description="The file to read", subtype="FILE_PATH", options={"SKIP_SAVE"}
    )
    filter_glob: bpy.props.StringProperty(
        name="Filter", description="Which files are shown", default=GLOB, options={"HIDDEN"}
    )
    object: bpy.props.StringProperty(
        name="Belong to",
        description="Name of the mesh that the landmarks are on: they become its children, for pairing",
        options={"SKIP_SAVE"},
    )
    collection: bpy.props.StringProperty(
        name="Collection", description="Its name; empty for that of the file", options={"SKIP_SAVE"}
    )

    def run(self, context: bpy.types.Context) -> tuple[str, str]:
        """Read the file, then make the empties."""
        from ..femors_addon import landmarkfiles

        if not self.filepath:
            raise FemorsError("No file named: pass filepath='<path>'")
        path = bpy.path.abspath(self.filepath)
        landmarkfiles.ending_of(path)
        read = landmarkfiles.read(path, self.space)
        parent = scene.find(self.object, "mesh of the landmarks") if self.object else None
        stem = os.path.basename(path)[: -len(landmarkfiles.ending_of(path))]
        made = marks.add(context, self.collection or stem, read.labels, read.points, parent=parent)
        return (
            "INFO",
            f"'{made.name}': {counted(len(read.points), 'landmark')} from '{os.path.basename(path)}'",
        )


@add_properties(setting_properties(AxesSettings, flags=ARGUMENT))
class FEMORS_OT_export_landmarks(DeckOperator, bpy.types.Operator, ExportHelper):
    """Write landmarks to a CSV file or one of 3D Slicer: those of the table, of a collection, or selected"""

    bl_idname = "femors.export_landmarks"
    bl_label = "Export Landmarks"

    filename_ext = ""
    check_extension = None  # the ending says the format

    filepath: bpy.props.StringProperty(
        name="File",
        description="The file to write; its ending says the format",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    filter_glob: bpy.props.StringProperty(
        name="Filter", description="Which files are shown", default=GLOB, options={"HIDDEN"}
    )
    collection: bpy.props.StringProperty(
        name="Collection",
        description="Name of the collection whose empties are written; else those selected",
        options={"SKIP_SAVE"},
    )
    use_table: bpy.props.BoolProperty(
        name="Table",
        description="Write the landmarks of the panel's table, not empties",
        options={"SKIP_SAVE"},
    )
    use_figures: bpy.props.BoolProperty(
        name="Figures",
        description="Also distance, residual, stretch, projection and spread, as columns (CSV only)",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Propose a name."""
        if not self.filepath:
            self.filepath = os.path.join(os.path.dirname(bpy.data.filepath), "landmarks.csv")
        return ExportHelper.invoke(self, context, event)

    def run(self, context: bpy.types.Context) -> tuple[str, str]:
        """Put the landmarks together and write the file."""
        from ..femors_addon import landmarkfiles
        from ..femors_addon.files import write_bytes

        if not self.filepath:
            raise FemorsError("No file named: pass filepath='<path>'")
        path = bpy.path.abspath(self.filepath)
        ending = landmarkfiles.ending_of(path)
        names, points, figures = self._table(context) if self.use_table else self._empties(context)
        if self.use_figures and ending != ".csv":
            raise FemorsError(f"{path}: has no room for figures; write a .csv, or untick Figures")
        found = landmarkfiles.Landmarks(points, tuple(names), space=self.space)
        beside = figures if self.use_figures else None
        write_bytes(path, landmarkfiles.encoded(path, found, beside))
        return "INFO", f"{counted(len(names), 'landmark')} written to '{path}'"

    def _table(self, context: bpy.types.Context) -> tuple[list[str], Any, dict[str, list[Any]]]:
        rows = list(context.scene.femors_transfer.marks)
        if not rows:
            raise FemorsError("The table has no landmarks: transfer some first")
        figures = {key: [getattr(row, key) for row in rows] for key in marks.FIGURES}
        figures["spread"] = [value if value >= 0 else np.nan for value in figures["spread"]]
        return [row.name for row in rows], np.array([tuple(row.point) for row in rows]), figures

    def _empties(self, context: bpy.types.Context) -> tuple[list[str], Any, dict[str, list[Any]]]:
        if self.collection:
            collection = bpy.data.collections.get(self.collection)
            if collection is None:
                raise FemorsError(f"There is no collection named '{self.collection}'")
            where, items = f"'{self.collection}'", [i for i in collection.all_objects if i.type == "EMPTY"]
        else:
            items = sorted(
                (item for item in context.selected_objects if item.type == "EMPTY"),
                key=lambda item: item.name,
            )
            where = "the selection"
        if not items:
            raise FemorsError(f"There are no empties in {where}: select landmarks, or name their collection")
        named = marks.named(items, where)
        context.view_layer.update()
        figures = {
            key: [item.get(f"femors_{key}", np.nan) for item in named.values()] for key in marks.FIGURES
        }
        return list(named), np.array([marks.world(item) for item in named.values()]), figures


classes = (FEMORS_OT_import_landmarks, FEMORS_OT_export_landmarks)


def register() -> None:
    """Register the operators; `decks` draws their menu entries beside its own."""
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them back."""
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
