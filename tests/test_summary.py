"""A summary says the same in a terminal and on a page; what a log says stays text."""

import pytest

from stickslip_fit._summary import Column, Section, Summary, Table, paragraph

HOSTILE = "<script>alert(1)</script> {{ 7 * 7 }}"
TABLE = Table(
    "Errors",
    (
        Column("session", text=True),
        Column("rms", "nm", "absolute"),
        Column("worst", "nm", "absolute"),
        Column("rms", "%"),
    ),
    (("monday", "12.5", "−30.0", "1.3"), (HOSTILE, "7.0", "9.0", "0.7")),
    note="Over 10 nm is a lot.",
)


@pytest.fixture
def summary():
    folded = Table("Details", (Column("what", text=True),), (("everything",),), folded=True)
    return Summary(
        "Result of a log",
        ("The answer is 42 nm.",),
        (Section("Joint 3", ("A sentence.",), (TABLE, folded)),),
        flags=("something is doubtful " * 10,),
        provenance=(("log", "sha256 0123"),),
    )


def test_text_begins_with_the_answer_and_no_line_but_a_table_s_is_too_wide(summary):
    lines = summary.as_text(60).splitlines()
    assert lines[0] == "The answer is 42 nm."
    assert lines.index("Result of a log") < lines.index("Joint 3") < lines.index("Errors")
    (flag,) = (place for place, line in enumerate(lines) if line.startswith("! "))
    assert lines[flag + 1].startswith("  ")
    assert max(len(line) for line in lines if "alert" not in line and "−30.0" not in line) <= 60
    assert str(summary) == repr(summary) == summary.as_text()


def test_columns_line_up_under_their_units_and_groups():
    _, groups, heads, units, first, second, note = TABLE.as_text().splitlines()
    for head, unit, cell in (("rms", "nm", "12.5"), ("worst", "nm", "−30.0")):
        end = heads.index(head) + len(head) if head == "worst" else first.index(cell) + len(cell)
        assert units[:end].endswith(unit)
        assert first[:end].endswith(cell)
    assert len(units.partition("nm")[0]) > groups.index("absolute") >= len(HOSTILE)
    assert second.startswith(HOSTILE)
    assert note == TABLE.note


def test_a_group_s_head_has_room_over_a_narrow_column():
    columns = (Column("strategy", text=True), Column("±1 %", group="constant step"), Column("rms"))
    groups, heads, _ = Table("", columns, (("closed form", "8", "1"),)).as_text().splitlines()
    assert groups.split() == ["constant", "step"]
    assert groups.index("constant") + len("constant step") == heads.index("±1 %") + len("±1 %")


def test_what_is_folded_is_in_html_and_in_text_only_when_asked_for(summary):
    assert "everything" not in summary.as_text()
    assert "everything" in summary.as_text(full=True)
    assert "<details><summary>Details</summary>" in summary.as_html()


def test_a_page_holds_the_same_and_runs_nothing(summary):
    html = summary._repr_html_()
    assert "<script>" not in html
    assert "{{ 7 * 7 }}" in html
    for said in ("Result of a log", "Joint 3", "A sentence.", "monday", "sha256 0123"):
        assert said in html
    assert "42\N{NO-BREAK SPACE}nm" in html, "a number stays with its unit"


def test_control_letters_of_a_log_move_no_cursor():
    table = Table("", (Column("session", text=True),), (("a\x1b[2Jb\nc",),))
    assert table.as_text().splitlines() == ["session", "a [2Jb c"]


@pytest.mark.parametrize("width", [10, 12, 14])
def test_a_number_is_never_parted_from_its_unit(width):
    lines = paragraph("within 7.5 µm of 120 nm and 3 % or 4 steps", width).splitlines()
    assert not any(line.startswith(("µm", "nm", "%", "steps")) for line in lines)
    assert len(lines) > 2


def test_a_unit_that_all_cells_have_stands_in_the_head_of_a_file():
    columns = (Column("what", text=True), Column("size"), Column("95 % interval"), Column("mixed"))
    rows = (("a", "−3.0 ± 0.2 %", "−3.4 to −2.6 %", "1 nm"), ("b", "–", "1,000 to 2,000 %", "1 µrad"))
    lines = Table("Sizes", columns, rows).as_csv().splitlines()
    assert lines[0] == (
        'what,size (%),"size, standard error (%)","95 % interval, low (%)","95 % interval, high (%)",mixed'
    )
    assert lines[1:] == ["a,-3.0,0.2,-3.4,-2.6,1 nm", "b,,,1000,2000,1 µrad"]
