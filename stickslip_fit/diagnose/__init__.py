"""What the laws get wrong in a log: show it, name the cause, extend the law, measure the gain."""

from stickslip_fit.diagnose.diagnose import diagnose
from stickslip_fit.diagnose.diagnosis import Diagnosis, Finding, Gain, NextTraverse
from stickslip_fit.diagnose.telling.diagnosis_json import save_diagnosis

__all__ = ["Diagnosis", "Finding", "Gain", "NextTraverse", "diagnose", "save_diagnosis"]
