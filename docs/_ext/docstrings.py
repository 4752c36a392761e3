"""Docstrings as people write them: |x| is an absolute value, and a sentence does not end after "Eq."."""

import re
from typing import Any

# Code keeps its bars: literals, examples, and what is indented beyond the text.
_CODE = re.compile(r"``.*?``|`.*?`|^\s*(?:>>>|\.\.\.).*|^ {8,}.*")


def _escape(app: Any, what: str, name: str, thing: object, options: Any, lines: list[str]) -> None:
    lines[:] = [_escaped(line).replace("Eq. ", "Equation ") for line in lines]


def _escaped(line: str) -> str:
    kept, last = "", 0
    for code in _CODE.finditer(line):
        kept += line[last : code.start()].replace("|", r"\|") + code.group()
        last = code.end()
    return kept + line[last:].replace("|", r"\|")


def setup(app: Any) -> dict[str, bool]:
    """Escape before numpydoc reads the docstring."""
    app.connect("autodoc-process-docstring", _escape, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
