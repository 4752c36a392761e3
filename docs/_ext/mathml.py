"""Equations as MathML, which browsers draw by themselves: a page asks no other host for anything."""

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

# LaTeX sets a thin space around the name of a function; the converter does not.
_BEFORE = re.compile(r"(?<=[\w})])\s*(?=\\(?:sin|cos|tan|log|exp)\b)")
_AFTER = re.compile(r"(\\(?:sin|cos|tan|log|exp))\b(?!\s*[(^])")


def _mathml(latex: str, display: str) -> str:
    return convert(_AFTER.sub(r"\1\,", _BEFORE.sub(r"\,", latex)), display=display)


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(translator.starttag(node, "div", CLASS="math"))
    number = node["number"]
    if number:
        translator.body.append(f'<span class="eqno">({number})</span>')
    translator.body.append(f"{_mathml(node.astext(), 'block')}</div>\n")
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Offer the renderer to Sphinx as ``mathml``."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
