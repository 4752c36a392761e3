"""What a page may use: its own style and script, known by their hashes; and data that becomes neither."""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from markupsafe import Markup

_UNSAFE = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}


@dataclass(frozen=True)
class Trusted:
    """Style and script of a page, and the policy that allows nothing but them.

    Attributes
    ----------
    style, script : Markup
        The script is empty where a page has none.
    policy : str
        Content-Security-Policy: nothing is fetched, no other script runs.
    """

    style: Markup
    script: Markup
    policy: str


def trusted(*, script: bool) -> Trusted:
    """The report's style, and its script where the page has one."""
    style = _source("report.css")
    code = _source("report.js") if script else Markup("")
    scripts = _hash(code) if script else "'none'"
    policy = (
        f"default-src 'none'; style-src {_hash(style)}; script-src {scripts}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    return Trusted(style, code, policy)


def embedded(content: Any) -> Markup:
    r"""Data as JSON that can stand in a script element: no letter of it ends the element or begins another.

    Examples
    --------
    >>> embedded({"session": "</script>"})
    Markup('{"session":"\\u003c/script\\u003e"}')
    """
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Markup(text.translate(_UNSAFE))


def _source(name: str) -> Markup:
    return Markup(files("stickslip_fit.report").joinpath("templates", name).read_text("utf-8"))


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
