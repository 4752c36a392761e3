r"""Causes: systematic effects that the published laws leave out, each a class in the file of its family.

A cause acts at one stage of the model and so is one of four kinds: `StateCause` (an angle, the load, the
recoil), `TermCause` (added to the step size), `FactorCause` (times the step size) or `CountCause` (steps
added). It holds no parameter values: they are passed to it. One of your own takes a dozen lines, in a
notebook or a file:

>>> from dataclasses import dataclass
>>> import numpy as np
>>> @dataclass(frozen=True)
... class Hum(FactorCause):
...     name = "hum"
...     phrase = "the transformer next door is on every other minute"
...     physics = "Its field adds to the drive's own, so that steps come out longer or shorter."
...     shows_best = "one configuration twice, a minute apart"
...     columns = ("session_seconds",)
...     parameters = (CauseParameter("k", "%", "change of the step size while it is on"),)
...     null_values, scale = (0.0,), (0.01,)
...
...     def factor(self, state, values):
...         return 1.0 + values[0] * (state.column("session_seconds") // 60 % 2)

`extend` adds it to a law. A diagnosis looks for it as for any other, by
``diagnose(log, causes=library() + (Hum(),))``, or fitted by ``least_squares(log, causes=(Hum(),))``:

>>> from stickslip_fit.laws import Prismatic
>>> law = extend(Prismatic(), Hum())
>>> [parameter.name for parameter in law.parameters]
['a', 'b', 'c', 'hum.k']
>>> level = {"q2": [-np.pi / 2] * 2, "theta": [0.0] * 2, "psi": [0.0] * 2, "start": [0.0] * 2}
>>> level |= {"stop": [0.012] * 2, "session_seconds": [30.0, 90.0]}
>>> law.counts(level, np.array([976e-9, 0.3, 438e-9, 0.02]))[0].round()
array([12295., 12054.])

`columns` names what the equation needs of a row beside positions and angles; `scale` is a size that matters,
and sets what is tried; `sentence` and `remedy` are what a diagnosis says of it. One whose effect has a kink,
a place or a moment in it overrides `Cause.trials`. What refers to the log as a whole (a mean, a range)
becomes a field of the dataclass, fill_empty in by `Cause.bind`; fields are saved with the law, so they are
numbers, text or tuples of them. A factor may depend on the position of the joint, ``state.position``; where
it has features narrower than about a tenth of a traverse, `Cause.max_panel` says how narrow.

A package that is installed brings its causes along by an entry point, which names the cause or its class::

    [project.entry-points."stickslip_fit.causes"]
    hum = "our_lab.hum:Hum"
"""

from stickslip_fit.causes.base import Cause, ExtendedLaw, extend
from stickslip_fit.causes.environment import *  # noqa: F403
from stickslip_fit.causes.formula import FormulaCause, restore_formula_cause
from stickslip_fit.causes.generic import GenericCause
from stickslip_fit.causes.geometry import *  # noqa: F403
from stickslip_fit.causes.kinds import CountCause, FactorCause, OfJoints, StateCause, TermCause
from stickslip_fit.causes.load import *  # noqa: F403
from stickslip_fit.causes.parameters import CauseParameter, SizedParameter
from stickslip_fit.causes.position import *  # noqa: F403
from stickslip_fit.causes.profile import *  # noqa: F403
from stickslip_fit.causes.registry import FAMILIES, covariates, describe, explain_missing, library, restore
from stickslip_fit.causes.roles import TableRoles, prepare_rows
from stickslip_fit.causes.table_cause import ExtendedTableLaw, TableCause
from stickslip_fit.causes.table_library import generic_causes
from stickslip_fit.causes.temporal import *  # noqa: F403

__all__ = [
    "Cause",
    "CauseParameter",
    "CountCause",
    "ExtendedLaw",
    "ExtendedTableLaw",
    "FactorCause",
    "FormulaCause",
    "GenericCause",
    "OfJoints",
    "SizedParameter",
    "StateCause",
    "TableCause",
    "TableRoles",
    "TermCause",
    "covariates",
    "describe",
    "explain_missing",
    "extend",
    "generic_causes",
    "library",
    "prepare_rows",
    "restore",
    "restore_formula_cause",
]
__all__ += [name for family in FAMILIES for name in family.__all__]
