"""Tables of unbalanced models, against exact arithmetic."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.anova.formula import anova_rows, model_terms

# Unbalanced on purpose. The goldens are differences between residual sums of squares of the models that each
# type compares (in R's car, Anova(type = 2), and type = 3 with contr.sum), each found by Gram and Schmidt's
# elimination in fractions.Fraction: they are exact.
CROSSED = pd.DataFrame(
    {
        "a": list("ppppqqqqqrrrrr"),
        "b": list("uuuvuuvvvuvvvv"),
        "y": [3.0, 5.0, 4.0, 9.0, 2.0, 6.0, 11.0, 7.0, 12.0, 8.0, 1.0, 4.0, 3.0, 6.0],
    }
)
GOLDEN = {
    1: (3809 / 140, 21609 / 1100, 16089 / 275, 37.0),
    2: (222439 / 6600, 21609 / 1100, 16089 / 275, 37.0),
    3: (3.0, 507 / 41, 16089 / 275, 37.0),
}


def lines(rows, text, kind):
    values, terms = model_terms(rows, text, sums_to_zero=kind == 3)
    return anova_rows(values, terms, kind)


@pytest.mark.parametrize("kind", GOLDEN)
def test_unbalanced_factorial_tables_are_exact(kind):
    found = lines(CROSSED, "y ~ a * b", kind)
    assert [line.sum_of_squares for line in found] == pytest.approx(GOLDEN[kind], rel=1e-12)
    assert [line.df for line in found] == [2, 1, 2, 8]


def test_a_large_common_part_changes_no_digit():
    shifted = CROSSED.assign(y=CROSSED["y"] + 2.0**40)
    for kind, golden in GOLDEN.items():
        found = lines(shifted, "y ~ a * b", kind)
        assert [line.sum_of_squares for line in found] == pytest.approx(golden, rel=1e-12)


@pytest.mark.parametrize(
    "text",
    ["y ~ a * b", "y ~ b + a", "y ~ a / run", "y ~ a + x + b:x", "y ~ run + a", "y ~ a:b", "y ~ x + C(step)"],
)
def test_sequential_sums_of_squares_add_up_to_the_total(text):
    rng = np.random.default_rng(1)
    rows = CROSSED.assign(
        x=rng.standard_normal(14), run=[f"run {k}" for k in (0, 0, 1, 1, 2, 2, 3, 3, 4, 5, 5, 6, 6, 6)],
        step=np.arange(14) // 3,
    )  # fmt: skip
    found = lines(rows, text, 1)
    assert sum(line.sum_of_squares for line in found) == pytest.approx(
        np.sum((rows["y"] - rows["y"].mean()) ** 2)
    )
    assert sum(line.df for line in found) == 13


def test_nested_labels_may_start_anew_or_not():
    """Runs 1, 2, 3 within each session, or 1 to 9 over all: the same runs, so the same table.

    Counting columns in place of what they span gives the second 16 degrees of freedom for 6.
    """
    rng = np.random.default_rng(2)
    session, run = np.repeat(list("abc"), 6), np.tile(np.repeat([1, 2, 3], 2), 3)
    rows = pd.DataFrame({"session": session, "run": run, "y": rng.standard_normal(18) + run})
    unique = rows.assign(run=rows["run"] + 3 * pd.factorize(rows["session"])[0])
    anew = lines(rows, "y ~ session / C(run)", 1)
    over = lines(unique, "y ~ session / C(run)", 1)
    means = rows.groupby(["session", "run"])["y"].mean()
    by_hand = 2 * float(((means - means.groupby("session").transform("mean")) ** 2).sum())
    for found in (anew, over):
        assert [line.df for line in found] == [2, 6, 9]
        assert found[1].sum_of_squares == pytest.approx(by_hand)
        assert found[0].sum_of_squares == pytest.approx(
            6 * np.sum((rows.groupby("session")["y"].mean() - rows["y"].mean()) ** 2)
        )


def test_types_agree_with_statsmodels_where_all_cells_are_filled():
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    rng = np.random.default_rng(3)
    rows = CROSSED.assign(x=rng.standard_normal(14))
    fitted = ols("y ~ C(a, Sum) * C(b, Sum) + x", rows).fit()
    for kind in (2, 3):
        table = anova_lm(fitted, typ=kind)["sum_sq"]
        theirs = [table["C(a, Sum)"], table["C(b, Sum)"], table["x"], table["C(a, Sum):C(b, Sum)"]]
        ours = [line.sum_of_squares for line in lines(rows, "y ~ a * b + x", kind)]
        assert ours[:-1] == pytest.approx(theirs, rel=1e-9)
        assert ours[-1] == pytest.approx(table["Residual"], rel=1e-9)


@pytest.mark.parametrize("text", ["y ~ a * b", "y ~ a / run", "y ~ run + a", "y ~ a:b + x"])
def test_columns_that_others_span_take_no_degree_of_freedom_from_the_residual(text):
    """Against the scatter about cell means, written out; a pseudo-inverse that keeps what rounding leaves of
    such columns is off by several per cent in half of these.
    """
    rng = np.random.default_rng(4)
    for count in rng.integers(60, 400, 8):
        a, b = rng.integers(0, 7, (2, count))
        rows = pd.DataFrame({"y": 950.0 + a + 3 * rng.standard_normal(count), "x": rng.normal(1e3, 5, count)})
        rows = rows.assign(a=[f"a{k}" for k in a], b=[f"b{k}" for k in b], run=[f"{k}" for k in 7 * a + b])
        left = rows[["y", "x"]] - rows.groupby("run")[["y", "x"]].transform("mean")
        df, expected = count - rows["run"].nunique(), float(left["y"] @ left["y"])
        if "x" in text:
            df, expected = df - 1, expected - float(left["x"] @ left["y"]) ** 2 / float(left["x"] @ left["x"])
        for kind in (1, 2, 3):
            found = lines(rows, text, kind)[-1]
            assert found.df == df
            assert found.sum_of_squares == pytest.approx(expected, rel=1e-9)
