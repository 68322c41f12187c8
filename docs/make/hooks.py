# SPDX-License-Identifier: GPL-3.0-or-later
"""MkDocs hooks, so that no page needs a network: formulas become MathML as the site is built, and what lets
search work in pages opened from a folder comes with the manual."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

FORMULA = re.compile(r'<(span|div) class="arithmatex">\s*\\([(\[])(.*?)\\[)\]]\s*</\1>', re.DOTALL)


WORKER = "assets/iframe-worker.js"


THEIRS = "https://unpkg.com/iframe-worker/shim"


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Put our copy of the script in place of the one that a reader's browser would fetch."""
    return output.replace(THEIRS, "../" * page.url.count("/") + WORKER)


def on_post_template(output_content: str, **_: Any) -> str:
    """The same for the page that says that there is no such page."""
    return output_content.replace(THEIRS, WORKER)


def on_page_content(html_text: str, **_: Any) -> str:
    """Replace what pymdownx.arithmatex has marked."""
    return FORMULA.sub(_mathml, html_text)


def _mathml(found: re.Match[str]) -> str:
    kind, latex = found[1], html.unescape(found[3]).strip()
    made = convert(latex, display="block" if kind == "div" else "inline")
    if "\\" in made:
        raise ValueError(f"the formula {latex!r} has a command that is not known and would be shown as it is")
    return f'<{kind} class="formula">{made}</{kind}>'
