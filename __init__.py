# SPDX-License-Identifier: GPL-3.0-or-later
"""FEMORS, a Blender extension: mesh morphing by generalized regression neural networks.

Blender is imported only inside `register` and `unregister`, so that the core, its tests and its
command line work where there is no Blender.
"""


def register() -> None:
    """Register operators, then the panels that name them."""
    from . import operators, ui

    operators.register()
    ui.register()


def unregister() -> None:
    """Take everything back, in reverse."""
    from . import operators, ui

    ui.unregister()
    operators.unregister()
