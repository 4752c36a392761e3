r"""Why the step size is not what the law says: each cause a class, in the file of its family.

A cause acts at one station on the way from a state to a count, and so is one of four kinds: `StateCause`
(an angle, the load, the recoil), `TermCause` (added to the step size), `FactorCause` (times the step size) or
`CountCause` (steps added). It holds no values: they are handed to it. One of your own takes a dozen lines, in
a notebook or a file:

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
...     absent, scale = (0.0,), (0.01,)
...
...     def factor(self, state, values):
...         return 1.0 + values[0] * (state.column("session_seconds") // 60 % 2)

Added to a law it makes a law, and with the library it is looked for like any other, by
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
becomes a field of the dataclass, filled in by `Cause.bound`; fields are saved with the law, so they are
numbers, text or tuples of them. A factor may depend on the position of the joint, ``state.position``; where
it has features narrower than about a tenth of a traverse, `Cause.widest` says how narrow.

A package that is installed brings its causes along by an entry point, which names the cause or its class::

    [project.entry-points."stickslip_fit.causes"]
    hum = "our_lab.hum:Hum"
"""

from importlib.metadata import entry_points

import pandas as pd

from stickslip_fit.causes import environment, geometry, load, position, temporal
from stickslip_fit.causes.base import (
    Cause,
    CountCause,
    ExtendedLaw,
    FactorCause,
    StateCause,
    TermCause,
    extend,
)
from stickslip_fit.causes.environment import *  # noqa: F403
from stickslip_fit.causes.environment import Covariate
from stickslip_fit.causes.geometry import *  # noqa: F403
from stickslip_fit.causes.io import describe, restore
from stickslip_fit.causes.load import *  # noqa: F403
from stickslip_fit.causes.parameters import CauseParameter, SizedParameter
from stickslip_fit.causes.position import *  # noqa: F403
from stickslip_fit.causes.temporal import *  # noqa: F403
from stickslip_fit.logs.schema import COVARIATE_PREFIX

FAMILIES = (temporal, environment, geometry, load, position)
ENTRY_POINT = "stickslip_fit.causes"

__all__ = [
    "Cause",
    "CauseParameter",
    "CountCause",
    "ExtendedLaw",
    "FactorCause",
    "SizedParameter",
    "StateCause",
    "TermCause",
    "covariates",
    "describe",
    "extend",
    "library",
    "restore",
]
__all__ += [name for family in FAMILIES for name in family.__all__]


def library() -> tuple[Cause, ...]:
    """Every cause, in the order of the documentation; then those of installed packages.

    The toolkit's own are those that ``__all__`` lists in the module of a family. A package adds its own by
    the entry point ``stickslip_fit.causes``, which names a cause or a function without arguments that returns
    one.

    Examples
    --------
    >>> [cause.name for cause in library()][:3]
    ['thermal-warm-up', 'drift', 'session-jump']
    """
    kinds = [getattr(family, name) for family in FAMILIES for name in family.__all__]
    # A covariate has no name before it has a column.
    own = [kind() for kind in kinds if kind is not Covariate]
    return (*own, *(_loaded(point.load()) for point in entry_points(group=ENTRY_POINT)))


def covariates(rows: pd.DataFrame) -> tuple[Covariate, ...]:
    """A cause for every numeric column that the lab added."""
    return tuple(
        Covariate(name.removeprefix(COVARIATE_PREFIX))
        for name in rows.columns
        if name.startswith(COVARIATE_PREFIX)
    )


def _loaded(found: object) -> Cause:
    return found if isinstance(found, Cause) else found()  # type: ignore[operator]
