"""Compact inline SVG of matplotlib figures, and Picture: a figure with its title and caption.

A page whose content security policy allows only its own style sheet ignores style attributes, so they
become presentation attributes. What all children of a group share moves to the group.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from xml.etree import ElementTree

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from stickslip_fit.plotting._style import report_style

Element = ElementTree.Element

LINE_ENDS = {"stroke-linejoin": "round", "stroke-linecap": "butt"}  # as matplotlib's own style sheet has it
INHERITED = {"clip-rule", "text-anchor"} | {
    *("fill", "fill-opacity", "font-family", "font-size", "font-style", "font-weight", "stroke"),
    *(f"stroke-{name}" for name in ("dasharray", "dashoffset", "linecap", "linejoin", "opacity", "width")),
}
GEOMETRY = frozenset({"d", "x", "y", "width", "height", "points", "transform", "viewBox"})
TRAVERSES_PREFIX = "traverses-"

_DECIMALS = re.compile(r"-?\d+\.\d{3,}(?:e-?\d+)?")
_INVALID_XML = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")  # a log may hold them
_REFERENCE = re.compile(r"#([^)]+)")


def name_traverses(points: Artist, rows: Iterable[int]) -> None:
    """Number the markers of a line, in their order, by the log's usable traverses, for the page's script."""
    points.set_gid(TRAVERSES_PREFIX + ".".join(map(str, rows)))


def compact_svg(document: str, key: str) -> str:
    """A matplotlib SVG document as an element for a page; every name in it begins with `key`."""
    root = ElementTree.fromstring(_INVALID_XML.sub("\N{REPLACEMENT CHARACTER}", document))
    for element in root.iter():
        _simplify_element(element)
    _remove_styles(root)
    _rename_ids(root, key)
    for group in list(root.iter("g"))[::-1]:
        _hoist_attributes(group)
    body = "".join(ElementTree.tostring(child, encoding="unicode") for child in root)
    ends = " ".join(f'{name}="{value}"' for name, value in LINE_ENDS.items())
    return f'<svg viewBox="{root.get("viewBox")}" {ends} aria-hidden="true">{body}</svg>'


def _simplify_element(element: Element) -> None:
    """Names without namespaces, styles as attributes, short numbers, no whitespace between tags."""
    element.tag = element.tag.rpartition("}")[2]
    attributes = {name.rpartition("}")[2]: value for name, value in element.attrib.items()}
    for entry in filter(None, attributes.pop("style", "").split("; ")):
        name, _, value = entry.partition(": ")
        attributes[name] = value.rstrip(";")
    element.attrib = {
        name: _shorten_numbers(value) if name in GEOMETRY else value for name, value in attributes.items()
    }
    element.tail = None
    if element.tag not in ("text", "tspan"):
        element.text = None


def _shorten_numbers(value: str) -> str:
    """Coordinates to hundredths of a point; an exponent is a rounding error."""
    return " ".join(_DECIMALS.sub(lambda match: f"{float(match[0]):.2f}", value).split())


def _remove_styles(root: Element) -> None:
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in ("style", "metadata"):
                parent.remove(child)


def _rename_ids(root: Element, key: str) -> None:
    """Groups lose their ids, unless these number traverses; other elements get short ones."""
    numbers, names = count(), dict[str, str]()
    for element in root.iter():
        name = element.attrib.pop("id", "")
        if element.tag == "g":
            if name.startswith(TRAVERSES_PREFIX):
                element.set("data-traverses", name.removeprefix(TRAVERSES_PREFIX))
        elif name:
            names[name] = f"{key}-{next(numbers)}"
            element.set("id", names[name])
    for element in root.iter():
        for attribute in ("href", "clip-path"):
            if attribute in element.attrib:
                value = element.attrib[attribute]
                element.set(attribute, _REFERENCE.sub(lambda match: f"#{names[match[1]]}", value))


def _hoist_attributes(group: Element) -> None:
    """Attributes that all children of a group share become the group's."""
    for name, value in list(group[0].attrib.items()) if len(group) else []:
        movable = name in INHERITED or (name == "clip-path" and name not in group.attrib)
        if movable and all(child.get(name) == value for child in group):
            group.set(name, value)
            for child in group:
                del child.attrib[name]


@dataclass(frozen=True)
class Picture:
    """One figure of the report, or what it would take to draw it.

    Attributes
    ----------
    key : str
        Short name, unique within a page.
    caption : str
        What to see, with this log's numbers; where `svg` is None, what the log lacks.
    """

    key: str
    title: str
    caption: str
    svg: Markup | None


def make_picture(key: str, title: str, caption: str, figure: Figure) -> Picture:
    """A drawn figure, ready for a page."""
    return Picture(key, title, caption, Markup(to_svg(figure, key)))


def make_missing_picture(key: str, title: str, lacking: str) -> Picture:
    """A figure that the log cannot support."""
    return Picture(key, title, lacking, None)


def to_svg(figure: Figure, key: str) -> str:
    """A figure as inline SVG; the same figure and key give the same text, and nothing refers outside it."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if not axis.get_label_text():
                axis.set_label_coords(0.0, 0.0)  # its place would be found from the extent of all tick labels
    stream = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with report_style(), mpl.rc_context({"svg.hashsalt": key}):
        figure.savefig(stream, format="svg", metadata=nothing, facecolor="none")
    return compact_svg(stream.getvalue(), key)
