# SPDX-License-Identifier: GPL-3.0-or-later
"""FEMORS: mesh morphing and overclosure removal by generalized regression neural networks.

The numerical core: NumPy, SciPy and fast-simplification, never Blender. The method is that of
Andreassen et al. (2024), Med. Eng. Phys., doi:10.1016/j.medengphy.2024.104136.
"""
