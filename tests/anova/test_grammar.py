"""A formula is parsed and never evaluated; the terms are those of patsy, R's notation."""

import random
import re
import time
from pathlib import Path

import pandas as pd
import patsy
import pytest
from typer.testing import CliRunner

import stickslip_fit
from stickslip_fit.anova import analyze_formula
from stickslip_fit.anova.formula import model_terms
from stickslip_fit.anova.grammar import MAX_LENGTH, parse_formula
from stickslip_fit.cli._app import app
from stickslip_fit.errors import InputError

COLUMNS = ("y", "a", "b", "c", "d")


def random_sum(rng, depth=0):
    return rng.choice((" + ", " + ", " - ")).join(
        random_product(rng, depth) for _ in range(rng.randint(1, 3))
    )


def random_product(rng, depth):
    return rng.choice(("*", "/", ":")).join(random_power(rng, depth) for _ in range(rng.randint(1, 2)))


def random_power(rng, depth):
    if depth < 3 and rng.random() < 0.4:
        return f"({random_sum(rng, depth + 1)})" + rng.choice(("", "", "**2", "**3"))
    return rng.choice(("a", "b", "c", "d", "C(a)", "C(d)"))


def terms_of_patsy(text):
    described = patsy.ModelDesc.from_formula(text).rhs_termlist
    return {frozenset(factor.name() for factor in term.factors) for term in described} - {frozenset()}


def test_terms_are_those_of_patsy():
    rng, compared = random.Random(5), 0
    while compared < 100:
        text = f"y ~ {random_sum(rng)}"
        theirs = terms_of_patsy(text)
        if not theirs:
            continue
        compared += 1
        ours = parse_formula(text, COLUMNS).terms
        assert {frozenset(factor.name for factor in term) for term in ours} == theirs, text
        assert [len(term) for term in ours] == sorted(map(len, ours))


@pytest.fixture(scope="module")
def monday(campaign, read_table):
    return read_table(campaign())


CODE = (
    "__import__('os').system('touch {path}') ~ direction",
    "step_size ~ __import__('os').system('touch {path}')",
    "step_size ~ C(open('{path}', 'w'))",
    "step_size ~ C(direction, Treatment(open('{path}', 'w')))",
    "step_size ~ I(open('{path}', 'w') and 1)",
    "step_size ~ np.log(q3)",
    "step_size ~ direction.__class__",
    "step_size ~ [open(x, 'w') for x in ['{path}']]",
    "step_size ~ (lambda: open('{path}', 'w'))()",
    "step_size ~ {{open('{path}', 'w')}}",
    "step_size ~ Q(open('{path}', 'w').name)",
    "step_size ~ Q('direction' if open('{path}', 'w') else '')",
    "step_size ~ f'{{open(chr(0))}}'",
    "step_size ~ direction; open('{path}', 'w')",
    "step_size ~ direction\nimport os",
    "step_size ~ direction if direction else 1",
    "step_size ~ direction @ session",
    "step_size ~ direction % session",
    "step_size ~ C(C(direction))",
    "step_size ~ `direction`",
    "step_size ~ direction ** session",
    "step_size ~ exec('1')",
    "step_size := direction",
)


@pytest.mark.parametrize("text", CODE)
def test_code_is_refused_with_its_place_and_never_run(text, monday, tmp_path):
    path = tmp_path / "made"
    with pytest.raises(InputError, match=r"at character \d+, .*A formula has column names") as caught:
        analyze_formula(monday, text.format(path=path))
    assert len(caught.value.problems) == 1
    assert not path.exists()


@pytest.mark.parametrize("text", CODE[:4])
def test_the_command_refuses_code_too(text, tmp_path, monday):
    path = tmp_path / "made"
    monday.to_csv(tmp_path / "log.csv")
    asked = CliRunner().invoke(app, ["anova", str(tmp_path / "log.csv"), "--formula", text.format(path=path)])
    assert isinstance(asked.exception, InputError)
    assert not path.exists()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("y ~ b + aa", r"at character 9, 'aa' is no column; did you mean a\? there are a, b, c, d, y"),
        ("y ~ (a + b", "at character 11, a \\) is missing"),
        ("y ~ a + b)", "at character 10, '\\)' does not belong here"),
        ("y ~ a +", "at character 8, the formula ends where a name belongs"),
        ("", "at character 1, the formula ends"),
        ("y", "at character 2, a ~ is missing"),
        ("y ~ a ~ b", "at character 7, '~' does not belong"),
        ("y ~ a + 2", "at character 9, 2 stands for nothing"),
        ("y ~ a - 1", "leaves out the general mean"),
        ("y ~ a:0", "'0' is no name"),
        ("y ~ C(a, b)", "a ',' is|',' is not part of a formula"),
        ("y ~ C(2)", r"C\(...\) takes the name"),
        ("y ~ Q(a)", "name of a column in quotes"),
        ("y ~ sin(a)", "'sin' is no function"),
        ("y ~ a ** b", "whole number from 1 to 9"),
        ("y ~ a ** 99999999999999999999", "whole number from 1 to 9"),
        ("y ~ " + "9" * 900, "at character 5"),
        ("y ~ a" + " + a" * MAX_LENGTH, "4,005 characters"),
        ("y ~ " + "(" * 400 + "a" + ")" * 400, "nested more than 20 deep"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(text, reason):
    with pytest.raises(InputError, match=reason):
        parse_formula(text, COLUMNS)


def test_no_formula_takes_long():
    names = tuple(f"x{k}" for k in range(40))
    long = "(" + " + ".join(names) + ")"
    begun = time.perf_counter()
    for text in (f"{long}**9", f"{long}**9**9**9", "*".join(names), f"{long}:{long}/{long}", "/".join(names)):
        try:
            parse_formula(f"x0 ~ {text}", names)
        except InputError as error:
            assert "more than 64 terms" in str(error)  # noqa: PT017
    assert time.perf_counter() - begun < 1.0


def test_a_table_too_wide_to_compute_is_refused():
    rows = pd.DataFrame({name: range(3000) for name in "abc"}).assign(y=1.0)
    for text, sums_to_zero in (("y ~ C(a)", False), ("y ~ C(a)*C(b)*C(c)", True), ("y ~ C(a)", True)):
        with pytest.raises(InputError, match="parameters, too many to compute"):
            model_terms(rows, text, sums_to_zero=sums_to_zero)


HOSTILE = ("__import__('os')", "a b", "C(session)", "x + y", "{0.__class__}", "log", "Q", "`rm`", "Ω²")


@pytest.mark.slow
def test_columns_that_look_like_code_are_names_and_nothing_else(campaign, read_table):
    table = campaign(settings=({"joint": 3, "q2_deg": -90.0},), replicates=9)
    for number, name in enumerate(HOSTILE):
        table[name] = [(7 * k + number) % 5 for k in range(len(table))]
    log = read_table(table)
    for name in HOSTILE:
        quote = '"' if "'" in name else "'"
        tables = analyze_formula(log, f"step_size ~ direction + C(Q({quote}{name}{quote}))", joint=3)
        assert f"C({name})" in str(tables[0])
    with pytest.raises(InputError, match=re.escape("is no column")):
        analyze_formula(log, "step_size ~ x + y")


EVALUATES = re.compile(
    r"(?<![\w.])(eval|exec|compile|__import__)\(|\.(eval|query|from_formula)\(|read_pickle"
    r"|^\s*(import|from) (pickle|numexpr|patsy|formulaic)\b",
    re.MULTILINE,
)


def test_no_text_is_evaluated_anywhere_in_the_package():
    """Nothing runs text or reads pickles: neither formulas nor laws, causes, plans or results."""
    for path in Path(stickslip_fit.__file__).parent.rglob("*.py"):
        assert EVALUATES.search(path.read_text("utf-8")) is None, path
