# SPDX-License-Identifier: GPL-3.0-or-later
"""What `make docs` makes out of the code: the reference of the manual."""
