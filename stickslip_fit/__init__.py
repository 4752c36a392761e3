"""Step-size laws for piezoelectric stick-slip actuators, from step counts to calibrated moves.

A whole analysis is one import::

    import stickslip_fit as ssf

    log = ssf.read_log("my-log.csv")
    fit = ssf.fit(log)  # parameters with intervals and flags: fit.parameters, fit.plot_control()
    diagnosis = ssf.diagnose(log)  # what the law gets wrong, why, and what knowing it gains
    law = diagnosis.extended_law()  # a result again, with the causes in the law
    ssf.report(log, diagnosis=diagnosis).save("report.html")

A name is imported from its module when it is first used, so that ``import stickslip_fit`` is instant.
"""

from __future__ import annotations

# What type checkers take for true; the module `typing` takes longer than all else here.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from stickslip_fit import causes, laws
    from stickslip_fit._workflow import calibrate, fit
    from stickslip_fit.anova import Anova, analyze_formula, analyze_variance
    from stickslip_fit.bayes import Posterior, load_posterior
    from stickslip_fit.causes import FormulaCause as Cause
    from stickslip_fit.causes.law_file import LawsAndCauses, read_law_file
    from stickslip_fit.changes import Changes, detect_changes
    from stickslip_fit.diagnosis import Diagnosis, diagnose, diagnose_table, fit_table, next_experiment
    from stickslip_fit.drive.rehearsal import DriveTrace, rehearse_drive
    from stickslip_fit.errors import InputError
    from stickslip_fit.estimation import (
        Result,
        TableFit,
        held_out_errors,
        load_result,
        load_table_fit,
        physical_law,
    )
    from stickslip_fit.law_comparison import LawComparison, compare_laws
    from stickslip_fit.laws import Law
    from stickslip_fit.logs import Log, Plan, read_log, read_plan, write_log
    from stickslip_fit.machine import Machine, load_machine
    from stickslip_fit.moves import (
        DriveCommand,
        calibrated_arm,
        dead_reckon,
        map_accuracy,
        plan_move,
        predict,
        read_drives,
    )
    from stickslip_fit.reporting import Report, report
    from stickslip_fit.simulation import LawValues, read_law_values, simulate
    from stickslip_fit.strategies import Comparison, compare_strategies
    from stickslip_fit.studies import SimulationStudy, read_study, run_study

__version__ = "0.1.0"

_HOMES = {
    "_workflow": ("calibrate", "fit"),
    "anova": ("Anova", "analyze_formula", "analyze_variance"),
    "bayes": ("Posterior", "load_posterior"),
    "causes.law_file": ("LawsAndCauses", "read_law_file"),
    "changes": ("Changes", "detect_changes"),
    "diagnosis": ("Diagnosis", "diagnose", "diagnose_table", "fit_table", "next_experiment"),
    "drive.rehearsal": ("DriveTrace", "rehearse_drive"),
    "errors": ("InputError",),
    "estimation": ("Result", "TableFit", "held_out_errors", "load_result", "load_table_fit", "physical_law"),
    "law_comparison": ("LawComparison", "compare_laws"),
    "laws": ("Law",),
    "logs": ("Log", "Plan", "read_log", "read_plan", "write_log"),
    "machine": ("Machine", "load_machine"),
    "moves": (
        *("DriveCommand", "calibrated_arm", "dead_reckon", "map_accuracy", "plan_move", "predict"),
        "read_drives",
    ),
    "reporting": ("Report", "report"),
    "simulation": ("LawValues", "read_law_values", "simulate"),
    "strategies": ("Comparison", "compare_strategies"),
    "studies": ("SimulationStudy", "read_study", "run_study"),
}
_ALIASES = {"Cause": ("causes", "FormulaCause")}  # `causes.Cause` is what it becomes
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
_PACKAGES = ("causes", "laws")

__all__ = sorted([*_HOME_OF, *_ALIASES, *_PACKAGES])


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _PACKAGES:
        return import_module(f"{__name__}.{name}")
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home, own = _ALIASES.get(name) or (_HOME_OF[name], name)
    return getattr(import_module(f"{__name__}.{home}"), own)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
