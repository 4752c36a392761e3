"""A log too poor for a law still gets its report, which says what is missing."""

import numpy as np
import pytest

from stickslip_fit.diagnosis import pipeline
from stickslip_fit.reporting import report
from tests.conftest import CALIBRATION_3

PSI = tuple({"joint": 3, "q2_deg": -90.0, "psi_deg": psi} for psi in (-60.0, 30.0))
PARTS = tuple(
    {"joint": 1, "theta_deg": -90.0, "from_deg": start, "to_deg": start - 30.0}
    for start in (60.0, 30.0, 0.0, -30.0)
)
ONE_DAY = ("2012-03-05",)
POOR = {
    "one direction": (
        {"settings": CALIBRATION_3 + PSI, "directions": ("+",)},
        "Joint 3 was not driven in direction −: nothing is known of that.",
    ),
    "calibration only, once": (
        {"settings": CALIBRATION_3, "replicates": 1, "sessions": ONE_DAY},
        "cannot be judged: there is no traverse beside those that the calibration used",
    ),
    "partial traverses only": (
        {"settings": PARTS},
        "missing: a full traverse at q2 = -90°, q3 = 0 mm, theta = 0°",
    ),
    "no replicates": (
        {"settings": CALIBRATION_3 + PSI, "replicates": 1},
        "Whether that is as good as repeatability allows cannot be said for joint 3: too few replicates",
    ),
}


LACKING_FIGURES = {
    "one traverse": (
        {"settings": PSI[:1], "directions": ("+",), "replicates": 1, "sessions": ONE_DAY},
        "Residuals of the law, joint 3 (prismatic). It would need a second traverse.",
    ),
    "never without load": (
        {"settings": ({"joint": 2, "q3_mm": 0.0}, {"joint": 2, "q3_mm": 12.0}), "sessions": ONE_DAY},
        "It would need full traverses of joint 2 at psi = 0 with theta = −90° and with theta = 0",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LACKING_FIGURES)
def test_a_figure_that_a_log_cannot_support_says_what_it_lacks(campaign, fitted, read_page, name):
    how, said = LACKING_FIGURES[name]
    made = fitted(campaign(**how))
    page = report(made.log, calibration=made.calibration, fit=made.fit, sections=("figures",)).html
    assert said in read_page(page).text


@pytest.mark.slow
@pytest.mark.parametrize("name", POOR)
def test_a_poor_log_is_reported_with_what_it_lacks(campaign, reported, name):
    how, said = POOR[name]
    assert said in reported(campaign(**how)).page.text


@pytest.mark.slow
def test_a_section_that_does_not_converge_says_which_computation_failed(campaign, read_table, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(pipeline, "find_gross_errors", fail)
    log = read_table(campaign(settings=CALIBRATION_3))
    failed = (
        "stickslip_fit.diagnosis.pipeline.diagnose_problem did not converge (Eigenvalues did not converge)"
    )
    assert failed in report(log, sections=("diagnosis",)).html


@pytest.mark.slow
def test_what_cannot_be_known_is_called_so(campaign, reported):
    page = reported(campaign(settings=PSI)).page
    assert "Not every parameter of joint 3 can be calibrated" in page.text
    missing = "b cannot be known from 4 usable traverses; missing: a full traverse at q2 = 0°, theta = -90°"
    assert missing in page.text
    caption = "Parameters of joint 3 (prismatic)"
    assert set(page.column(caption, "b")) == {"not known"}
    estimators = page.column(caption, "estimator")
    a = page.column(caption, "anm")
    assert [cell == "not known" for cell in a] == [name == "closed form" for name in estimators]
    assert "nan" not in page.text.lower().split()


@pytest.mark.slow
def test_interrupted_and_excluded_traverses_are_counted(campaign, reported):
    table = campaign(settings=CALIBRATION_3 + PSI)
    table["status"] = ["interrupted", "excluded", "excluded"] + ["ok"] * (len(table) - 3)
    page = reported(table).page
    assert (
        "Not fitted, but part of the history: 1 interrupted traverse and 2 excluded traverses." in page.text
    )
    row = page.tables["Sessions and traverses"][0]
    assert row[-2:] == ["1", "2"]
