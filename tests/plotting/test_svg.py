"""Figures are made smaller, not different."""

import io
import re
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from stickslip_fit.plotting._style import report_style
from stickslip_fit.plotting._svg import name_traverses, to_svg

SEEN = ("fill", "stroke", "stroke-width", "stroke-dasharray", "stroke-linecap", "font-size", "text-anchor")
DRAWN = ("path", "use", "text")
LABEL = "day 1.23456 & <b>"


@pytest.fixture(scope="module")
def figure():
    figure = Figure(figsize=(4, 3))
    axis = figure.subplots()
    x = np.linspace(0.0, 1.0, 7)
    drawn = axis.errorbar(x, np.sin(7 * x), yerr=0.1, marker="s", ls="--", color="#0072B2", mfc="white")
    name_traverses(drawn[0], [5, 7, 9, 11, 13, 15, 170])
    axis.plot(x, x, ls="", marker="o", color="#D55E00", alpha=0.5)
    axis.set_title(LABEL)
    return figure


def tree(text):
    root = ElementTree.fromstring(text)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def looks(root, inherited):
    """How each thing that is drawn ends up looking, worked out from its own style and its parents'."""
    found = []
    for child in root:
        own = dict(entry.split(": ") for entry in child.get("style", "").split("; ") if entry)
        own |= {name: child.get(name) for name in SEEN if name in child.attrib}
        style = inherited | own
        if child.tag in DRAWN:
            where = [round(float(child.get(name, 0)), 2) for name in "xy"]
            found.append((child.tag, where, numbers(child.get("d", "")), [style.get(each) for each in SEEN]))
        if child.tag not in ("defs", "clipPath", "style", "metadata"):
            found += looks(child, style)
    return found


def numbers(path):
    return [round(float(each), 2) for each in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", path)]


def test_everything_stays_where_it_was_and_looks_as_it_did(figure):
    stream = io.StringIO()
    with report_style(), mpl.rc_context({"svg.hashsalt": "key"}):
        figure.savefig(stream, format="svg", facecolor="none")  # the page shows through
    before, after = tree(stream.getvalue()), tree(to_svg(figure, "key"))
    ends = {"stroke-linecap": "butt"}
    assert after.get("stroke-linecap") == "butt"
    was, now = looks(before, ends), looks(after, ends)
    assert [each[0] for each in was] == [each[0] for each in now]
    for (_, *first), (_, *second) in zip(was, now, strict=True):
        assert first[2] == second[2]
        assert first[0] == pytest.approx(second[0], abs=0.011)
        assert first[1] == pytest.approx(second[1], abs=0.011)
    assert len(to_svg(figure, "key")) < 0.6 * len(stream.getvalue())


def test_no_style_is_left_and_every_name_is_the_figure_s_own(figure):
    root = tree(to_svg(figure, "key"))
    assert not [each for each in root.iter() if "style" in each.attrib or each.tag == "style"]
    names = {each.get("id") for each in root.iter() if each.get("id")}
    assert all(name.startswith("key-") for name in names)
    wanted = {each.get("href", "").removeprefix("#") for each in root.iter("use")}
    wanted |= set(re.findall(r"url\(#([^)]+)\)", to_svg(figure, "key")))
    assert wanted <= names


def test_words_are_left_alone(figure):
    assert LABEL in [each.text for each in tree(to_svg(figure, "key")).iter("text")]


def test_points_say_which_traverses_they_are(figure):
    (group,) = [each for each in tree(to_svg(figure, "key")).iter("g") if "data-traverses" in each.attrib]
    assert group.get("data-traverses") == "5.7.9.11.13.15.170"
    assert len(list(group.iter("use"))) == 7
