# SPDX-License-Identifier: GPL-3.0-or-later
"""Making the zips that users install: ``make package`` and ``make lock``. Never part of a zip."""
