"""One screen by default, everything with --full, every table as CSV and LaTeX; help with an example."""

import csv
import io
import re
from pathlib import Path

import pytest

from stickslip_fit import _progress
from stickslip_fit._progress import show_progress
from stickslip_fit._summary import SCREEN, Column, Section, Summary, Table
from stickslip_fit.cli._commands import CAPTURE_EXAMPLES
from stickslip_fit.cli._commands import COMMANDS as ENTRIES
from stickslip_fit.cli._show import name_left_out
from stickslip_fit.diagnosis._summary import format_bayes_factor
from tests.cli.test_files import COMMANDS
from tests.docs.commands import parse

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "data" / "reference" / "campaign.csv"
MIXED = Table(
    "Sizes of joint_1 & more",
    (Column("session", text=True), Column("a", "nm", "fit"), Column("range", "%", "fit"), Column("steps")),
    (("[x] 5 %", "−1,234.5 ± 0.5", "−1.0 to 2.0", "12,150"), ("y", "–", "–", "–")),
    note="50 % of #1",
)


def make_summary(rows: int) -> Summary:
    long = Table("Long", (Column("n"),), tuple((str(n),) for n in range(rows)), short=slice(-2, None))
    detail = Section("Detail", tables=(Table("Deep", (Column("n"),), (("deep",),) * 30),))
    return Summary("Title", ("The answer.",), (Section(tables=(long,)), detail), flags=("Beware.",))


@pytest.mark.parametrize("rows", [3, 18, 19, 40])
def test_a_screen_holds_the_answer_and_names_what_it_leaves_out(rows):
    summary = make_summary(rows)
    text, left_out = summary.as_screen()
    assert text.startswith("The answer.\n\n! Beware.")
    assert len(text.splitlines()) + 2 <= SCREEN
    assert "Detail" in left_out
    assert ("every row" in left_out) == (f"\n{0:>{len(str(rows - 1))}}\n" not in text)
    assert text.rstrip().endswith(str(rows - 1)), "the rows that stand for all are the last"
    full = summary.as_text(full=True)
    assert all(f"{number}\n" in full for number in range(rows))
    assert full.count("deep") == 30


def test_what_is_left_out_stands_on_one_line():
    line = name_left_out([f"Table number {number} of many" for number in range(20)])
    assert len(line) <= 110
    assert re.search(r"Table number 0 of many; .*; \d+ more\. --csv DIR", line)


def test_csv_has_plain_numbers_with_their_units():
    head, first, second = csv.reader(io.StringIO(MIXED.as_csv()))
    assert head == [
        *("session", "fit: a (nm)", "fit: a, standard error (nm)"),
        *("fit: range, low (%)", "fit: range, high (%)", "steps"),
    ]
    assert first == ["[x] 5 %", "-1234.5", "0.5", "-1.0", "2.0", "12150"]
    assert second == ["y", "", "", "", "", ""]


def test_latex_escapes_what_is_a_command_and_sets_groups():
    text = MIXED.as_latex()
    assert r"\caption{Sizes of joint\_1 \& more}" in text
    assert r"\multicolumn{2}{c}{fit}" in text
    assert r"\cmidrule(lr){2-3}" in text
    assert r"{[x] 5 \%} & $-$1,234.5 $\pm$ 0.5 & $-$1.0 to 2.0 & 12,150 \\" in text
    assert r"{\footnotesize 50 \% of \#1}" in text
    assert text.isascii() or not re.search(r"[−±µ°–]", text)


def test_every_table_is_saved_and_no_log_is_replaced(run, refused, tmp_path):
    folder, latex = tmp_path / "tables", tmp_path / "tables.tex"
    status, out, _ = run("check", REFERENCE, "--csv", folder, "--latex", latex)
    assert status == 0
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["conditions.csv", "coverage-usable-traverses.csv", "sessions-and-traverses.csv"]
    assert latex.read_text().count(r"\begin{table}") == 3
    assert f"3 tables saved in {folder}" in out
    log = tmp_path / "sessions-and-traverses.csv"
    log.write_bytes(REFERENCE.read_bytes())
    assert "is a log that this was computed from" in refused("check", log, "--csv", tmp_path)
    assert log.read_bytes() == REFERENCE.read_bytes()


def test_every_command_has_an_example_that_can_be_typed(run):
    examples = {name: entry.example for name, entry in ENTRIES.items() if entry.example}
    examples |= {f"capture {name}": example for name, example in CAPTURE_EXAMPLES.items()}
    assert {command.name for command in COMMANDS} == set(examples)
    for name, example in examples.items():
        parse(example.split())
        status, out, _ = run(*name.split(), "--help")
        assert status == 0
        assert f"  stickslip-fit {example}\n" in out


def test_what_was_perhaps_meant_is_said_and_options_are_called_by_their_names(refused):
    said = refused("fit", REFERENCE, "--cause", "thermal-warmup")
    assert said.startswith(
        "--cause, value 'thermal-warmup': is no cause that is known; did you mean thermal-warm-up?"
    )


def test_the_example_of_a_plan_can_be_used(run, tmp_path):
    plan = tmp_path / "plan.toml"
    assert run("plan", "--example", "-o", plan)[0] == 0
    assert plan.read_text().count("#") > 5
    assert run("sheet", plan, "-o", tmp_path / "sheet.csv")[0] == 0
    assert "--example makes a plan" in run("plan", REFERENCE, "--example")[2]


@pytest.mark.slow
def test_the_example_of_a_stage_can_be_used(run, tmp_path):
    stage, chart = tmp_path / "stage.toml", tmp_path / "step.svg"
    assert run("step", "--example", "-o", stage)[0] == 0
    status, out, _ = run("step", stage, "--chart", chart, "--csv", tmp_path / "tables")
    assert status == 0
    assert out.startswith("Joint 3, outward: a step of 980.0 nm with Coulomb friction.\nFriction-limited")
    assert len(out.splitlines()) <= 25 + 2  # and what was saved
    assert chart.read_text().count("step size (nm)") == 5
    assert len(list((tmp_path / "tables").glob("*.csv"))) == 8
    assert "means nothing with --example" in run("step", stage, "--example")[2]
    assert "--example writes one" in run("step")[2]


def test_no_bayes_factor_beyond_a_million_is_shown():
    shown = [format_bayes_factor(power) for power in (240.7, 6.0, 2.0, 0.0, -0.4, -50.0, float("nan"))]
    assert shown == ["> 1,000,000", "1,000,000", "100", "1", "0.4", "< 0.01", "–"]


@pytest.mark.parametrize(("every", "lines"), [(1000.0, []), (0.0, ["searching: 50 %", "judging: 100 %"])])
def test_without_a_terminal_progress_is_a_line_now_and_then(monkeypatch, capsys, every, lines):
    monkeypatch.setattr(_progress, "LINE_EVERY", every)
    with show_progress() as progress:
        progress("searching", 0.5)
        progress("judging", 1.0)
    assert capsys.readouterr().err.splitlines()[-2:] == lines


@pytest.mark.slow
def test_fit_says_where_residuals_scatter_more_than_replicates(run, campaign, tmp_path):
    """A bend of one joint's response that its replicates have in common."""
    table = campaign(("2012-03-05", "2012-03-06"), replicates=3)
    table.to_csv(tmp_path / "plain.csv", index=False)
    bent = (table["joint"] == 3) & (table["q2_deg"] == -60.0)
    table.loc[bent, "steps"] = (table.loc[bent, "steps"] * 1.03 / 5).round().astype(int) * 5
    table.to_csv(tmp_path / "bent.csv", index=False)
    assert "law misses something" not in run("fit", tmp_path / "plain.csv")[1]
    first = " ".join(run("fit", tmp_path / "bent.csv")[1].split())
    expected = r"The residual scatter is [\d.]+ %, the replicate scatter [\d.]+ % \(joint 3, "
    assert re.match(expected, first)
    assert "the law misses something; run stickslip-fit diagnose." in first
