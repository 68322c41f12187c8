# SPDX-License-Identifier: GPL-3.0-or-later
"""MkDocs hook: formulas become MathML as the site is built, so that no page needs a script or a network."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

FORMULA = re.compile(r'<(span|div) class="arithmatex">\s*\\([(\[])(.*?)\\[)\]]\s*</\1>', re.DOTALL)


def on_page_content(html_text: str, **_: Any) -> str:
    """Replace what pymdownx.arithmatex has marked."""
    return FORMULA.sub(_mathml, html_text)


def _mathml(found: re.Match[str]) -> str:
    kind, latex = found[1], html.unescape(found[3]).strip()
    made = convert(latex, display="block" if kind == "div" else "inline")
    return f'<{kind} class="formula">{made}</{kind}>'
