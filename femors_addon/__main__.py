# SPDX-License-Identifier: GPL-3.0-or-later
"""``python -m femors_addon``: the command line."""

import os
import sys

# before NumPy is imported: the small systems solved here gain nothing from threads, which only wait
# for each other (femur_pair on two busy cores: 7 s of CPU with one thread, 12 s with two)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

try:
    from .cli import main
except KeyboardInterrupt:  # while modules are read; later the command line tells
    print("femors: interrupted; nothing is written", file=sys.stderr)
    sys.exit(130)

sys.exit(main())
