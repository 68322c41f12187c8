# SPDX-License-Identifier: GPL-3.0-or-later
"""Switching the extension on and off, and its properties against the core's settings."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from checkout import PACKAGE


def registered() -> set[str]:
    """Everything of FEMORS that Blender knows."""
    kinds = (
        bpy.types.AddonPreferences,
        bpy.types.Operator,
        bpy.types.Panel,
        bpy.types.PropertyGroup,
        bpy.types.UIList,
        bpy.types.Menu,
    )
    names = {cls.__name__ for kind in kinds for cls in kind.__subclasses__() if cls.is_registered}
    found = {name for name in names if name.startswith("FEMORS")}
    found |= {f"ops.{name}" for name in dir(bpy.ops.femors)}
    found |= {f"{t.__name__}.femors" for t in (bpy.types.Scene, bpy.types.Object) if hasattr(t, "femors")}
    for name in dir(bpy.app.handlers):
        handlers = getattr(bpy.app.handlers, name)
        if isinstance(handlers, list):
            found |= {f"{name}: {h.__module__}" for h in handlers if h.__module__.startswith(PACKAGE)}
    return found


def test_switching_off_and_on_leaves_nothing_behind(extension, part):
    command = part("operators.command").Command
    before = registered()
    assert {"FEMORS_OT_morph", "FEMORS_PT_morph", "Scene.femors", "ops.morph"} <= before
    assert command.handle is not None
    extension.unregister()
    assert registered() == set()
    assert command.handle is None
    extension.register()
    assert registered() == before
    extension.unregister()
    extension.register()
    assert registered() == before


def test_enabling_imports_nothing_heavy(tmp_path):
    """Blender starts with it each time: NumPy alone would cost more than all of FEMORS."""
    if bpy.app.binary_path:
        pytest.skip("needs a Python of its own; test_installed and tests/window look at this in the binary")
    code = (
        "import sys; sys.path.insert(0, 'demo'); "
        "import checkout; here = checkout.Checkout(); import bpy; before = set(sys.modules); here.enable(); "
        "new = set(sys.modules) - before; "
        "heavy = ('numpy', 'scipy', 'fast_simplification', 'meshio'); "
        "print('imported', [m for m in heavy if m in new]); "
        "core = checkout.PACKAGE + '.femors_addon.'; "
        "print('core', sorted(m[len(core):] for m in new if m.startswith(core))); "
        "assert bpy.ops.femors.morph.poll(); "
        "print('asked', [m for m in heavy[1:] if m in sys.modules]); "
        "here.disable()"
    )
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, timeout=60, check=False
    )
    said = done.stdout + done.stderr
    assert "imported []" in done.stdout and "asked []" in done.stdout, said
    light = ["limits", "morph_settings", "overclosure_settings", "progress", "settings", "transfer_settings"]
    assert f"core {[*light, 'version']}" in done.stdout, said
    assert done.returncode == 0, "bpy did not come to a clean end: something of ours keeps it alive"


@pytest.mark.parametrize("holder", ["operator", "form"])
def test_properties_say_what_the_settings_say(part, holder):
    settings = part("femors_addon.settings")
    morph_settings = part("femors_addon.morph_settings")
    kind = bpy.ops.femors.morph.get_rna_type() if holder == "operator" else bpy.types.Scene.bl_rna
    properties = kind.properties if holder == "operator" else bpy.context.scene.femors.bl_rna.properties
    for name, (field, spec) in settings.specs(morph_settings.MorphSettings).items():
        shown = properties[name]
        assert (shown.name, shown.description) == (spec.label, spec.help)
        if spec.choices:
            assert tuple((i.identifier, i.name, i.description) for i in shown.enum_items) == spec.choices
            assert shown.default == field.default
            continue
        assert shown.default == pytest.approx(field.default, rel=1e-6)
        if spec.minimum is not None:
            assert shown.hard_min == pytest.approx(spec.minimum, rel=1e-6)
        if spec.maximum is not None:
            assert shown.hard_max == pytest.approx(spec.maximum, rel=1e-6)


def test_all_arguments_are_explained(extension):
    for name in (n for n in dir(bpy.ops.femors) if not n.startswith("_")):
        kind = getattr(bpy.ops.femors, name).get_rna_type()
        assert kind.description, name
        for key, item in kind.properties.items():
            assert key == "rna_type" or item.description, f"{name}.{key}"


def test_lengths_are_plain_numbers(empty):
    """With a unit of its own, Blender would write a spread of 10 mm as "10 m"."""
    for name in ("spread_start", "spread_end", "normal_weight", "field_spread"):
        made = bpy.context.scene.femors.bl_rna.properties[name]
        assert made.unit == "NONE"


@pytest.mark.parametrize(
    ("system", "unit", "scale", "expected"),
    [
        ("METRIC", "METERS", 1.0, (1.0, "scene units")),  # Blender's factory settings
        ("METRIC", "ADAPTIVE", 1.0, (1.0, "scene units")),
        ("NONE", "ADAPTIVE", 0.001, (1.0, "scene units")),
        ("METRIC", "MILLIMETERS", 0.001, (1.0, "mm")),
        ("METRIC", "ADAPTIVE", 0.001, (1.0, "mm")),
        ("METRIC", "MILLIMETERS", 1.0, (1000.0, "mm")),
        ("METRIC", "CENTIMETERS", 0.001, (0.1, "cm")),
        ("IMPERIAL", "INCHES", 0.0254, (1.0, "in")),
        ("METRIC", "ADAPTIVE", 0.5, (0.5, "m")),
    ],
)
def test_the_figures_are_in_the_scenes_unit(empty, part, system, unit, scale, expected):
    settings = bpy.context.scene.unit_settings
    settings.system = system
    settings.scale_length = scale
    if system != "NONE":
        settings.length_unit = unit
    factor, name = part("ui.figures").length_unit(settings)
    assert (round(factor, 6), name) == expected


def test_numbers_in_narrow_columns_are_fixed_and_short(part):
    fixed = part("ui.figures").fixed
    cases = (-2.9e-6, 0.0, 0.00012, 0.0043, -0.0234, 0.8921, -1.25, 12.34, 99.96, 1464.4)
    expected = ("0", "0", "0.0001", "0.0043", "-0.023", "0.89", "-1.25", "12.3", "100", "1464")
    assert tuple(map(fixed, cases)) == expected


@pytest.mark.parametrize("way", ["mixed", "surface", "nearest"])
def test_settings_are_grey_only_where_they_do_nothing(part, way):
    is_used, stages = part("ui.panels").is_used, part("femors_addon.schedule").stages
    plain = part("femors_addon.morph_settings").MorphSettings(correspondence=way)
    edges, size = [3.0, 2.0, 1.0], 100.0
    for name in ("normal_weight", "fine_normal_weight", "normal_decay", "fine_normal_decay", "spread_start"):
        other = dataclasses.replace(plain, **{name: 0.5})
        assert is_used(name, way) == (stages(other, edges, size) != stages(plain, edges, size)), name


def test_presets_answer_no_question_about_the_data(part):
    """The panel keeps what was said of the data when a preset is chosen, so presets must not differ there."""
    settings, module = part("femors_addon.settings"), part("femors_addon.morph_settings")
    for name, (_, spec) in settings.specs(module.MorphSettings).items():
        if not spec.advanced and name != "preset":
            assert len({getattr(preset, name) for preset in module.PRESETS.values()}) == 1, name


def test_choosing_a_preset_fills_the_form(empty, part):
    module, form_of = part("femors_addon.morph_settings"), part("operators.form")
    form = bpy.context.scene.femors
    form.alignment = "rigid"
    for name in module.PRESETS:
        form.preset = name
        assert form_of.changed_from_preset(form, module.MorphSettings, module.PRESETS) == []
    assert form.alignment == "rigid"
    form.spread_end = 3.25
    assert form_of.changed_from_preset(form, module.MorphSettings, module.PRESETS) == ["spread_end"]
    bpy.ops.femors.reset_preset()
    assert form_of.changed_from_preset(form, module.MorphSettings, module.PRESETS) == []


class Call:
    """Stands in for an operator's properties: values, of which some were given by the caller."""

    def __init__(self, defaults, **given):
        self.__dict__.update(dataclasses.asdict(defaults) | given)
        self.given = set(given)

    def is_property_set(self, name):
        return name in self.given


def test_a_preset_holds_except_for_what_the_caller_gives(part):
    module, form_of = part("femors_addon.morph_settings"), part("operators.form")
    call = Call(module.MorphSettings(), preset="published", spread_start=8.0, step_scale=0.949999988079071)
    read = form_of.read_settings(call, module.MorphSettings, module.PRESETS)
    assert read == dataclasses.replace(module.PRESETS["published"], spread_start=8.0, step_scale=0.95)


def test_numbers_come_out_of_single_precision_as_they_were_typed(part):
    import numpy as np

    exact = part("operators.form").exact
    for value in (0.95, 1e-4, 0.0, 12.5, 0.333333, 1234.56, 2e-7):
        assert exact(float(np.float32(value))) == value


@pytest.fixture()
def dependencies(part):
    """The module, which forgets what it has looked up before and after a test."""
    module = part("operators.dependencies")
    module.forget()
    yield module
    module.forget()


FORM = ("unit", "colour_map", "threads", "memory")


class Layout:
    """Takes down what a panel draws."""

    def __init__(self):
        self.said = []

    def column(self, **options):
        return self

    def prop(self, data, name):
        assert name in FORM, name

    def label(self, text="", icon="NONE"):
        self.said.append((icon, text))


def preferences(part) -> tuple[str, str]:
    """Return what the preferences show: the icon of the first line, and all lines as one."""

    class Region:
        width = 700

    class Context:
        region = Region

        class preferences:
            class system:
                ui_scale = 1.0

    class Preferences:
        layout = Layout()

    part("ui.preferences").FEMORS_preferences.draw(Preferences, Context)
    said = Preferences.layout.said
    return said[0][0], " ".join(text for _, text in said)


def test_the_preferences_say_what_is_there(part, dependencies):
    import numpy as np

    icon, said = preferences(part)
    assert icon == "NONE"
    assert f"FEMORS {part('femors_addon.version').version()} with NumPy {np.__version__}, SciPy 1." in said
    assert "meshio 5" in said and "no " not in said


@pytest.mark.parametrize("packaged", [False, True])
def test_a_missing_package_is_a_sentence(empty, part, monkeypatch, dependencies, packaged, capfd):
    command, progress = part("operators.command"), part("femors_addon.progress")
    monkeypatch.setitem(dependencies.NEEDED, "no_such_package", "NoSuch")
    monkeypatch.setattr(dependencies, "PACKAGED", packaged)
    assert dependencies.missing().startswith(f"NoSuch not found in Blender's Python 3.{sys.version_info[1]}")
    assert "README" in dependencies.missing()
    assert ("zip" in dependencies.missing(), "pip" in dependencies.missing()) == (packaged, not packaged)
    assert preferences(part)[0] == "ERROR"
    assert preferences(part)[1].startswith(dependencies.missing() + " FEMORS ")
    with pytest.raises(progress.FemorsError, match="NoSuch not found"):
        dependencies.require()
    assert not bpy.ops.femors.morph.poll()
    with pytest.raises(RuntimeError, match="NoSuch not found"):
        bpy.ops.femors.morph(source="a", target="b")
    assert command.run(["morph"]) == 2
    assert "Traceback" not in capfd.readouterr().err


def test_a_package_for_another_numpy_is_a_sentence(empty, part, monkeypatch, dependencies):
    real = dependencies.importlib.metadata.requires

    def requires(name):
        return ["numpy<1.20,>=1.19"] if name == "scipy" else real(name)

    monkeypatch.setattr(dependencies.importlib.metadata, "requires", requires)
    icon, said = preferences(part)
    assert icon == "ERROR" and "wants NumPy <1.20,>=1.19, and this Blender has " in said
    with pytest.raises(RuntimeError, match="wants NumPy"):
        bpy.ops.femors.morph(source="a", target="b")


@pytest.mark.parametrize(
    ("requirement", "version", "allowed"),
    [
        ("numpy<2.5,>=1.23.5", "1.24.3", True),
        ("numpy<2.5,>=1.23.5", "1.23.4", False),
        ("numpy<2.5,>=1.23.5", "2.5.0", False),
        ("numpy (<2.5,>=1.23.5)", "2.4.0rc1", True),
        ("numpy>=2.0", "2", True),
        ("numpy>1.9", "1.26.4", True),
        ("numpy", "1.0", True),
        ("numpy<1; python_version < '3.9'", "1.26.4", True),
    ],
)
def test_bounds_of_versions(dependencies, requirement, version, allowed):
    assert dependencies.allows(requirement, version) is allowed


def test_a_package_that_cannot_be_loaded_is_a_sentence(part, monkeypatch, dependencies):
    progress = part("femors_addon.progress")

    def clash(name):
        raise ValueError("numpy.dtype size changed,\n may indicate binary incompatibility")

    monkeypatch.setattr(dependencies.importlib, "import_module", clash)
    with pytest.raises(progress.FemorsError) as caught:
        dependencies.require()
    assert "numpy.dtype size changed" in str(caught.value) and "README" in str(caught.value)
    monkeypatch.undo()
    assert preferences(part)[0] == "ERROR" and preferences(part)[1].startswith(str(caught.value))
    assert "\n" not in str(caught.value)
