"""Simulated studies: thousands of campaigns with known truth, and which calibration survives what."""

from stickslip_fit.strategies.study.backends import Backend, Cores
from stickslip_fit.strategies.study.cluster import Cluster
from stickslip_fit.strategies.study.numbers import save_study
from stickslip_fit.strategies.study.plan import Scenario, StudyPlan
from stickslip_fit.strategies.study.read import read_study, usual_of_study
from stickslip_fit.strategies.study.run import run_study
from stickslip_fit.strategies.study.study import Study

__all__ = [
    "Backend",
    "Cluster",
    "Cores",
    "Scenario",
    "Study",
    "StudyPlan",
    "read_study",
    "run_study",
    "save_study",
    "usual_of_study",
]
