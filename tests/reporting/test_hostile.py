"""Names, notes and files come from outside: none of them may become markup, a formula or a crash."""

import html
import json

import pandas as pd
import pytest

from stickslip_fit.errors import shorten

SCRIPT = "<script>alert(1)</script>"
IMAGE = '"><img src=x onerror=alert(2)>'
JINJA = "{{ 7 * 7 }}{% raw %}"
FORMULA = r"$\frac{1}{$"
ENTITY = "&lt;b&gt;&amp;#10;--><!--"
LONG = "Montag " * 40
BELL = "bell \x07 \ufffe"
SCRIPTS_OF_THE_WORLD = "第三次 тест \u202egnirts"


SESSIONS = (SCRIPT, IMAGE, JINJA, FORMULA, BELL, ENTITY, LONG.strip(), SCRIPTS_OF_THE_WORLD)
SETTINGS = (
    {"joint": 3, "q2_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0},
    *({"joint": 3, "q2_deg": -90.0, "psi_deg": psi} for psi in (-60.0, 30.0, 60.0)),
)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(SESSIONS, id="first", marks=pytest.mark.nightly),
        pytest.param(SESSIONS[::-1], id="last"),
    ],
)
def hostile(request, campaign, reported):
    """Figures show the latest sessions only, so that each name gets its turn among them."""
    days = [
        campaign((f"2012-03-{day:02d}",), SETTINGS).assign(session=name)
        for day, name in enumerate(request.param, start=5)
    ]
    table = pd.concat(days, ignore_index=True).assign(note="", status="ok")
    table.loc[[0, 1, 2], "note"] = [SCRIPT, IMAGE, JINJA]
    table.loc[3, "status"] = "excluded"
    table["<b>pressure</b>"] = "1"
    return reported(table, name='a<b>&"c.csv')


def figures(page):
    return "".join(part.split("</svg>")[0] for part in page.source.split("<svg")[1:])


@pytest.mark.slow
def test_nothing_hostile_becomes_an_element(hostile):
    tags = {tag for tag, _ in hostile.page.elements}
    assert not tags & {"img", "b"}
    assert [attributes for tag, attributes in hostile.page.elements if tag == "script"] == [
        {"type": "application/json", "id": "traverses"},
        {},
    ]
    assert not any(name.startswith("on") for _, attributes in hostile.page.elements for name in attributes)


def test_hostile_text_is_shown_as_it_was_written(hostile):
    for text in (*SESSIONS, 'a<b>&"c.csv'):
        assert text in hostile.page.text


def test_hostile_text_reaches_the_script_as_data(hostile):
    source, script = hostile.page.scripts
    assert not set(source) & set("<>&\u2028\u2029")
    data = json.loads(source)
    assert data["sessions"] == [*hostile.log.sessions]
    assert set(data["joints"][0]["notes"].values()) == {SCRIPT, IMAGE, JINJA}
    assert "<b>pressure</b>" not in source
    assert not any(name in script for name in SESSIONS)


def test_session_names_stay_inert_within_figures(hostile):
    labels = figures(hostile)
    assert "<script" not in labels
    assert "<img" not in labels
    for name in hostile.log.sessions[-2:]:
        assert html.escape(shorten(name, 12), quote=False) in labels


def test_excluded_traverses_and_notes_are_listed(hostile):
    rows = hostile.page.tables["Traverses with a note or not fitted"]
    assert [row[4:] for row in rows] == [["ok", SCRIPT], ["ok", IMAGE], ["ok", JINJA], ["excluded", ""]]
