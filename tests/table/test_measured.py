"""Measured tables from textbooks, whose analyses are known."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf

# Survival times in units of 10 hours, by poison and treatment A to D, four animals each: G. Box and D. Cox,
# J. R. Stat. Soc. B 26:211, 1964, table 1.
SURVIVAL = {
    "I": (0.31, 0.45, 0.46, 0.43, 0.82, 1.10, 0.88, 0.72, 0.43, 0.45, 0.63, 0.76, 0.45, 0.71, 0.66, 0.62),
    "II": (0.36, 0.29, 0.40, 0.23, 0.92, 0.61, 0.49, 1.24, 0.44, 0.35, 0.31, 0.40, 0.56, 1.02, 0.71, 0.38),
    "III": (0.22, 0.21, 0.18, 0.23, 0.30, 0.37, 0.38, 0.29, 0.23, 0.25, 0.24, 0.22, 0.30, 0.36, 0.31, 0.33),
}


@pytest.mark.nightly
def test_rates_of_dying_depend_on_poison_and_treatment_and_not_on_both_together():
    """The noise is what the additive analysis of variance of the rates leaves."""
    table = pd.concat(
        pd.DataFrame(
            {"poison": poison, "treatment": np.repeat(list("ABCD"), 4), "rate": 1.0 / np.array(times)}
        )
        for poison, times in SURVIVAL.items()
    )
    found = ssf.diagnose_table(table, "rate ~ mean")
    assert {one.cause for one in found.findings} == {"covariate:poison", "covariate:treatment"}
    design = pd.get_dummies(table[["poison", "treatment"]], drop_first=True).to_numpy(float)
    design = np.column_stack([np.ones(48), design])
    left = table["rate"].to_numpy() - design @ np.linalg.lstsq(design, table["rate"].to_numpy())[0]
    assert np.isclose(found.repeatability, np.sqrt(left @ left / (48 - 6)), rtol=0.05)
    assert found.gain.extended < 0.5 * found.gain.baseline
