# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties that are worked out once, without a lock.

Python 3.11 holds a lock for each `functools.cached_property` of a class while it is worked out, whatever
object it is of: threads at work on two surfaces waited for each other. Later Pythons have none either. Two
threads that ask one object at once may both work it out; they come to the same bits.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, TypeVar

T = TypeVar("T")


class cached_property(functools.cached_property[T]):
    """As `functools.cached_property` of Python 3.12."""

    if not TYPE_CHECKING:

        def __get__(self, instance, owner=None):
            """Return the value, from the object's dictionary if it is there."""
            if instance is None:
                return self
            known = instance.__dict__
            if self.attrname not in known:
                known[self.attrname] = self.func(instance)
            return known[self.attrname]
