"""What each effect does to a count, against the equations done by hand."""

import numpy as np
import pandas as pd
import pytest

from tests.hidden.by_hand import TABLE, count
from tests.hidden.designs import DESIGNS
from tests.hidden.generate import Hidden, UnreachableError, hide


def _laws(hidden: Hidden) -> list[dict[str, float]]:
    """The true parameters at each row."""
    laws: list[dict[str, float]] = [{}] * len(hidden.table)
    for place in hidden.campaign.places:
        for number, row in enumerate(place.rows):
            laws[row] = {name: float(values[number, 0]) for name, values in place.values.items()}
    return laws


def _some(rows: pd.DataFrame) -> list[int]:
    """One row in the middle of each joint's and direction's, and the last but one."""
    groups = rows.reset_index().groupby(["joint", "direction"], observed=True)["index"]
    return [int(each) for _, group in groups for each in (group.iloc[len(group) // 2], group.iloc[-2])]


def _edges(change: np.ndarray) -> list[int]:
    """Where an effect is largest and smallest, where it sets in, and the row before."""
    first = int(np.argmax(np.abs(change) > 1e-6))
    return [int(np.argmax(change)), int(np.argmin(change)), first, max(first - 1, 0)]


def _complete(rows: pd.DataFrame) -> pd.DataFrame:
    means = {f"mean_{name}": rows[name].mean() for name in ("temperature", "humidity", "supply")}
    return rows.assign(**means, median_step_period=rows["step_period"].median())


def _parameters(hidden: Hidden) -> dict[str, float | str]:
    """Values by name, joint and direction; beside a moment, its session."""
    said = hidden.truth["effects"][0]["parameters"]
    values = {f"{p['name']}{p.get('joint', '')}{p.get('direction', '')}": p["value"] for p in said}
    return values | {key: p[key] for p in said for key in ("session",) if key in p}


@pytest.mark.parametrize("design", DESIGNS)
def test_counts_without_effects_are_the_published_laws_integral(design, read):
    hidden = hide(design, seed=7)
    rows, laws = read(hidden), _laws(hidden)
    for row in _some(rows):
        assert hidden.campaign.counts[row] == pytest.approx(count(rows.loc[row], laws[row]), rel=1e-9)


@pytest.mark.parametrize("name", TABLE)
def test_the_tables_form_departs_as_its_row_says(name, read):
    hidden = hide("many", (name,), 12, seed=3, forms={name: "table"})
    rows, laws = _complete(read(hidden)), _laws(hidden)
    rows["steps_before"] = hidden.campaign.steps_before
    change, steps, p = hidden.effect(name), hidden.expected(), _parameters(hidden)
    chosen = [*_some(rows), *_edges(change)]
    assert np.ptp(change[chosen]) > 1e-3
    for row in chosen:
        by_hand = count(rows.loc[row], laws[row], TABLE[name], p)
        assert steps[row] == pytest.approx(by_hand, rel=2e-7)
        assert change[row] == pytest.approx(np.log(by_hand / hidden.campaign.counts[row]), abs=2e-7)


def test_a_recorded_payload_scales_the_load_coefficient(read):
    seed = next(seed for seed in range(9) if "payload_g" in hide("many", seed=seed).table)
    hidden = hide("many", ("payload-change",), 12, seed=seed, forms={"payload-change": "recorded"})
    rows, laws, k = read(hidden), _laws(hidden), _parameters(hidden)["k"]

    def heavier(traverse, p) -> None:
        traverse.heavier = 1 + k / 100 * 1e3 * traverse.row["payload"]

    for row in _some(rows) + _edges(hidden.effect("payload-change")):
        by_hand = count(rows.loc[row], laws[row], heavier)
        assert hidden.expected()[row] == pytest.approx(by_hand, rel=1e-9)


def test_a_lab_column_acts_through_a_smooth_function_of_it_alone():
    for form in ("straight", "threshold", "hump"):
        hidden = hide("many", ("covariate",), 12, seed=5, forms={"covariate": form})
        column = hidden.truth["effects"][0]["cause"].removeprefix("covariate:")
        order = np.argsort(hidden.table[column].to_numpy())
        change = hidden.effect("covariate")[order]
        assert np.ptp(change) > 2e-3
        assert np.abs(np.diff(change)).max() < np.ptp(change) / 3


@pytest.mark.parametrize(
    ("form", "chain"), [("all joints", ["session"]), ("each joint", ["session", "joint"])]
)
def test_memory_carries_rho_from_traverse_to_traverse(form, chain):
    hidden = hide("many", ("unknown:memory",), 16, seed=9, forms={"unknown:memory": form})
    (effect,) = hidden.truth["effects"]
    rho, campaign = effect["parameters"][0]["value"], hidden.campaign
    departure = hidden.effect("unknown:memory") / campaign.repeatability + campaign.innovations
    before = hidden.table.assign(departure=departure).groupby(chain)["departure"].shift()
    known = before.notna()
    assert 0.4 < rho < 0.8
    np.testing.assert_allclose((departure - rho * before)[known], campaign.innovations[known], atol=1e-9)
    # Sampling error of an autocorrelation: sqrt((1 - rho^2) / n); four of them.
    autocorrelation = np.corrcoef(departure[known], before[known])[0, 1]
    assert autocorrelation == pytest.approx(rho, abs=4 * np.sqrt((1 - rho**2) / known.sum()))
    assert np.std(departure) == pytest.approx(1 / np.sqrt(1 - rho**2), rel=0.15)


@pytest.mark.parametrize("seed", range(6))
def test_misfires_are_few_and_far_off_and_the_rest_is_right(seed):
    hidden = hide("thesis", ("end-stop-misfire",), 14, seed=seed)
    offset = hidden.effect("end-stop-misfire") / hidden.campaign.repeatability
    assert 1 <= np.sum(np.abs(offset) > 1e-9) <= 0.02 * len(offset)
    assert np.abs(offset[np.abs(offset) > 1e-9]).min() >= 6 - 1e-9
    rms = np.sqrt(np.mean(hidden.effect("end-stop-misfire") ** 2))
    assert hidden.truth["effects"][0]["effect_rms_pct"] == pytest.approx(100 * rms)


def test_a_misfire_too_weak_to_be_one_is_refused():
    with pytest.raises(UnreachableError, match="of strength 4 in this log"):
        hide("thesis", ("end-stop-misfire",), 4, seed=2)
