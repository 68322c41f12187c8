# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators `femors.import_deck` and `femors.export_deck`, their menu entries, and drag and drop.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

import os
import traceback
from pathlib import Path
from typing import Any, ClassVar

import bpy
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..femors_addon.progress import FemorsError, counted
from . import deck_export, deck_scene, deck_store, dependencies

ENDINGS = (".inp", ".feb", ".bdf", ".nas", ".fem", ".vtk", ".vtu", ".msh", ".mesh")
"""Those of `femors_addon.deckfiles`, which takes SciPy to import; a test compares them."""
LANDMARKS = "Landmarks (.csv, .fcsv, .mrk.json)"
LABEL = "FE model (.inp, .feb, .vtu ...)"
GLOB = ";".join(f"*{ending}" for ending in ENDINGS)


class DeckOperator:
    """Mix-in: a user's error is one line, anything else a traceback and one line."""

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do it, and report."""
        try:
            dependencies.require()
            level, line = self.run(context)
        except FemorsError as error:
            return self.refused(" ".join(str(error).split()))
        except MemoryError:
            return self.refused("Not enough memory for a model of this size: close other programs")
        except Exception as error:
            traceback.print_exc()
            return self.refused(
                f"FEMORS failed unexpectedly ({type(error).__name__}: {error}); details are in the console"
            )
        self.report({level}, line)
        return {"FINISHED"}

    def refused(self, line: str) -> set[str]:
        """Report an error."""
        self.report({"ERROR"}, line)
        return {"CANCELLED"}


class ObjectMaker(DeckOperator):
    """Mix-in of what makes objects."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Objects are made in Object Mode."""
        cls.poll_message_set("Leave Edit Mode or painting first")
        return context.mode == "OBJECT"


class FEMORS_OT_import_deck(ObjectMaker, bpy.types.Operator, ImportHelper):
    """Read a finite-element model (Abaqus, FEBio, Nastran, VTK, Gmsh): one object for each of its parts"""

    bl_idname = "femors.import_deck"
    bl_label = "Import FE Model"
    bl_options: ClassVar[set[str]] = {"UNDO"}

    filepath: bpy.props.StringProperty(
        name="File", description="The file to read", subtype="FILE_PATH", options={"SKIP_SAVE"}
    )
    directory: bpy.props.StringProperty(
        name="Folder", description="Folder of the files", subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"}
    )
    files: bpy.props.CollectionProperty(
        type=bpy.types.OperatorFileListElement,
        name="Files",
        description="Names of several files in the folder",
        options={"SKIP_SAVE", "HIDDEN"},
    )
    filter_glob: bpy.props.StringProperty(
        name="Filter", description="Which files are shown", default=GLOB, options={"HIDDEN"}
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for a file, unless it was dropped."""
        if self.filepath or self.files:
            return self.execute(context)
        return ImportHelper.invoke(self, context, event)

    def run(self, context: bpy.types.Context) -> tuple[str, str]:
        """Read all files before the first object is made."""
        paths = [os.path.join(self.directory, one.name) for one in self.files if one.name] or [self.filepath]
        if paths == [""]:
            raise FemorsError("No file named: pass filepath='<path>'")
        read = []
        for path in paths:
            deck, files = deck_store.read(bpy.path.abspath(path))
            if not deck.parts:
                raise FemorsError(f"{path}: has no elements with a surface (solids or shells)")
            read.append((deck, files, [deck_scene.plan(deck, *one) for one in deck.parts.items()]))
        items, lines, level = [], [], "INFO"
        for deck, files, plans in read:
            name = deck.path.name
            made = deck_scene.build(context, deck.path.stem, deck_store.keep(name, files), plans)
            items += made
            notes = list(deck.notes)
            size = sum(map(len, files.values()))
            if size > deck_store.LARGE:
                notes.append(f"the .blend keeps the deck's {size / 1e6:.0f} MB, compressed, and grows by it")
            level = "WARNING" if notes else level
            lines.append("; ".join([_told(name, deck, made), *notes]))
        _select(context, items)
        return level, "; ".join(lines)


def _told(name: str, deck: Any, made: list[bpy.types.Object]) -> str:
    groups = sum(len(item.vertex_groups) for item in made)
    return (
        f"'{name}': {counted(len(made), 'object')}, {counted(len(deck.coordinates), 'node')}, "
        f"{counted(deck.mesh.element_count, 'element')}, "
        f"{counted(groups, 'set as a vertex group', 'sets as vertex groups')}"
    )


def _select(context: bpy.types.Context, items: list[bpy.types.Object]) -> None:
    """Select new objects, the first one active."""
    context.view_layer.update()
    for other in context.selected_objects:
        other.select_set(False)
    for item in items:
        if item.name in context.view_layer.objects:
            item.select_set(True)
    if items and items[0].name in context.view_layer.objects:
        context.view_layer.objects.active = items[0]


class FEMORS_OT_export_deck(DeckOperator, bpy.types.Operator, ExportHelper):
    """Write a finite-element model with the nodes where the selected parts have them; all else stays"""

    bl_idname = "femors.export_deck"
    bl_label = "Export FE Model"

    filename_ext = ""
    check_extension = None  # the ending says the format

    filepath: bpy.props.StringProperty(
        name="File",
        description="The file to write; the deck's own format keeps every line but the coordinates",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    filter_glob: bpy.props.StringProperty(
        name="Filter", description="Which files are shown", default=GLOB, options={"HIDDEN"}
    )
    object: bpy.props.StringProperty(
        name="Object",
        description="Name of the object whose model is written; else the selected ones, or the active one",
        options={"SKIP_SAVE", "HIDDEN"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Propose the deck's name; refuse before a path is asked for."""
        try:
            items = deck_export.chosen(context, self.object)
            name = deck_export.file_name(items[0])
        except FemorsError as error:
            return self.refused(str(error))
        if not self.filepath:
            own, made = Path(name), items[0].name != items[0].data.femors.part
            stem = f"{own.stem} morphed" if made else own.stem
            self.filepath = os.path.join(os.path.dirname(bpy.data.filepath), stem + own.suffix)
        return ExportHelper.invoke(self, context, event)

    def run(self, context: bpy.types.Context) -> tuple[str, str]:
        """Put the nodes together and write the file."""
        if not self.filepath:
            raise FemorsError("No file named: pass filepath='<path>'")
        items = deck_export.chosen(context, self.object)
        return deck_export.write(context, items, bpy.path.abspath(self.filepath))


class FEMORS_FH_deck(bpy.types.FileHandler):
    """A deck dropped on a window is imported."""

    bl_idname = "FEMORS_FH_deck"
    bl_label = "FE model"
    bl_import_operator = "femors.import_deck"
    bl_file_extensions = ";".join(ENDINGS)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Where objects are seen."""
        return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}


def draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entries of File > Import, those of `landmarks` too."""
    self.layout.operator("femors.import_deck", text=LABEL)
    self.layout.operator("femors.import_landmarks", text=LANDMARKS)


def draw_export(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entries of File > Export, those of `landmarks` too."""
    self.layout.operator("femors.export_deck", text=LABEL)
    self.layout.operator("femors.export_landmarks", text=LANDMARKS)


classes = (FEMORS_OT_import_deck, FEMORS_OT_export_deck, FEMORS_FH_deck)


def register() -> None:
    """Register operators, file handler and menu entries."""
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.TOPBAR_MT_file_import.append(draw_import)
    bpy.types.TOPBAR_MT_file_export.append(draw_export)


def unregister() -> None:
    """Take everything back."""
    bpy.types.TOPBAR_MT_file_export.remove(draw_export)
    bpy.types.TOPBAR_MT_file_import.remove(draw_import)
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
