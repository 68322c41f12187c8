# SPDX-License-Identifier: GPL-3.0-or-later
"""For every test: linear algebra in one thread, set before NumPy is imported."""

import os

# thousands of 4 x 4 systems gain nothing from threads, and on a busy machine their waiting for each
# other made the same tests take six times as long
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
