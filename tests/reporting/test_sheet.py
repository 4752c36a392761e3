import json
import re
from html.parser import HTMLParser

import pytest

from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.reporting.moves import sheet_html, write_sheet_page
from tests.reporting.test_page import sha256

PLAN = """
name = "<script>alert(1)</script> & co"
check_every = 10
[sessions]
dates = [2012-03-05, 2012-03-06]
labels = ["first", "<b>second</b>"]
[[sweep]]
joint = 3
name = "<img src=x onerror=alert(1)>"
q2_deg = [-90, 0]
theta_deg = [-90, 0]
[[sweep]]
joint = 2
q3_mm = 12
ranges_deg = [[0, -30], [-30, -60]]
directions = ["-", "+"]
replicates = 2
"""


class Page(HTMLParser):
    """The tags of a page, and its table rows as lists of (class, text)."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.rows, self.cell, self.addresses = [], [], None, []
        self.attributes, self.text = [], ""
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += attributes
        self.addresses += [value for name, value in attributes if name in ("src", "href")]
        if tag == "tr":
            self.rows.append([])
        if tag == "td":
            self.cell = [dict(attributes).get("class", ""), ""]
            self.rows[-1].append(self.cell)

    def handle_endtag(self, tag):
        if tag == "td":
            self.cell = None

    def handle_data(self, data):
        self.text += data
        if self.cell is not None:
            self.cell[1] += data

    @property
    def drives(self):
        """The last six cells of each traverse's row: joint, direction, ends, and three boxes."""
        return [row for row in self.rows if len(row) > 1]


@pytest.fixture
def plan(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return read_plan(path, load_machine())


@pytest.fixture
def page(plan):
    return Page(sheet_html(plan))


def test_every_traverse_has_a_row_with_empty_boxes_for_time_steps_and_remark(plan, page):
    assert len(page.drives) == len(plan.rows()) == 2 * (8 + 8)
    for row in page.drives:
        assert [(kind, text.strip()) for kind, text in row[-3:]] == [("box", "")] * 3
    assert [row[0][1] for row in page.drives] == [str(number) for number in range(1, 17)] * 2


def test_rows_say_which_joint_to_drive_which_way_between_which_ends(page):
    told = [tuple(text for _, text in row[-6:-3]) for row in page.drives[:16]]
    assert told[:2] == [("3", "+", "0 to 12 mm"), ("3", "−", "12 to 0 mm")]
    assert told[8:12] == [("2", "−", "0 to −30 deg"), ("2", "+", "−30 to 0 deg")] * 2
    assert told[12:14] == [("2", "−", "−30 to −60 deg"), ("2", "+", "−60 to −30 deg")]


def test_what_has_to_be_set_is_told_once_a_visit_and_what_changed_is_emphasised(page):
    settings = [[tuple(cell) for cell in row[1:6]] for row in page.drives[:16] if len(row) == 12]
    same = ("same", "0")
    assert settings == [
        [("changed", "−90"), ("changed", "0"), ("changed", "0"), ("changed", "−90"), ("same", "moves")],
        [("changed", "0"), same, same, ("same", "−90"), ("same", "moves")],
        [("changed", "−90"), same, same, ("changed", "0"), ("same", "moves")],
        [("changed", "0"), same, same, same, ("same", "moves")],
        [same, same, same, ("same", "moves"), ("changed", "12")],
        [same, same, same, ("same", "moves"), ("same", "12")],
    ]
    ends = [row[-4] for row in page.drives[:16]]
    assert [kind for kind, _ in ends] == ["changed"] * 2 + ["same"] * 6 + ["changed"] * 8


def test_names_from_the_plan_are_text_and_never_markup(page, plan):
    assert not {"script", "img"} & set(page.tags)
    html = sheet_html(plan)
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; co" in html
    assert "&lt;b&gt;second&lt;/b&gt;" in html
    assert "&lt;img src=x" in html


def test_the_page_asks_for_nothing_from_elsewhere(page, plan):
    assert page.addresses == []
    assert not any(sign in sheet_html(plan) for sign in ("url(", "@import", "http:", "https:"))


def test_the_page_is_written_as_utf8(plan, tmp_path):
    write_sheet_page(plan, tmp_path / "sheet.html")
    assert (tmp_path / "sheet.html").read_text(encoding="utf-8") == sheet_html(plan)


def test_the_policy_trusts_this_style_alone_and_no_script(plan):
    source = sheet_html(plan)
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', source.replace("&#39;", "'"))
    rules = {name: set(rest) for name, *rest in map(str.split, policy.split(";"))}
    (style,) = re.findall(r"<style>(.*?)</style>", source, re.DOTALL)
    assert rules["style-src"] == {sha256(style)}
    assert all(rules[name] == {"'none'"} for name in ("default-src", "script-src", "base-uri", "form-action"))
    assert source.index("http-equiv") < source.index("<style>")


HOSTILE = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(2)>',
    "</style><style>*{display:none}</style>",
    "</title><meta http-equiv=refresh content=0>",
    "{{ 7 * 7 }}{% raw %}",
    "&lt;b&gt;&amp;#10;--><!--",
    "'><base href=//elsewhere>",
)


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_texts_of_a_plan_are_shown_and_stay_inert(tmp_path, page, text):
    path, quoted = tmp_path / "plan.toml", json.dumps(text)
    names = ("<script>alert(1)</script> & co", "<b>second</b>", "<img src=x onerror=alert(1)>")
    content = PLAN
    for name in names:
        content = content.replace(json.dumps(name), quoted)
    path.write_text(content)
    hostile = Page(sheet_html(read_plan(path, load_machine())))
    assert hostile.tags == page.tags
    assert hostile.text.count(text) >= 5
    assert not any(name == "style" or name.startswith("on") for name, _ in hostile.attributes)
