import pytest

from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.logs import read_log
from stickslip_fit.moves import calibrated_arm


@pytest.fixture(scope="session")
def arm():
    """The latest session of the reference campaign."""
    return calibrated_arm(fit_least_squares(read_log("data/reference/campaign.csv")))
