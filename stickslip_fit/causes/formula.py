"""FormulaCause: a cause of one's own, as a formula or a Python function; `ssf.Cause`.

Its first sign says what it does: ``+ expression`` adds to the response of a table or to the step size of a
log, ``* expression`` multiplies it, ``name = expression`` stands in place of a column or a coordinate, and
``steps + expression`` adds to the count of a log.

>>> FormulaCause("viscous-by-direction", "+ dFv*abs(vel)", "dFv in N s/m").names
('dFv', 'vel')
>>> bounds = {"tau": (60, 3600)}
>>> FormulaCause("warm-up", "* (1 - A*expm1(-t/tau))", "A in %, tau in s", bounds=bounds).operation
'*'

`FormulaCause.bind_table` makes it a cause of a table, see `TableCause`; `FormulaCause.bind` one of a log.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import pandas as pd

from stickslip_fit._function import load_function
from stickslip_fit.causes.cause_formula import CauseFormula
from stickslip_fit.causes.formula_step import FormulaStepCause, bind_formula_to_log
from stickslip_fit.causes.formula_table import FormulaTableCause, bind_formula_to_table
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.table_cause import ExtendedTableLaw
from stickslip_fit.laws import TableLaw
from stickslip_fit.laws.quantities import OF_GEOMETRY, STATE_NAMES
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.machine import Machine


class FormulaCause(CauseFormula):
    """What a law leaves out, as a formula or a Python function; `CauseFormula` has its parameters."""

    @property
    def needs_geometry(self) -> bool:
        """See `Cause`."""
        return any(name in OF_GEOMETRY for name in (*self.names, self.target))

    @property
    def columns(self) -> tuple[str, ...]:
        """See `Cause`: every name that is no parameter."""
        own = [one.name for one in self.declared]
        return tuple(name for name in self.names if name not in own)

    @property
    def kind(self) -> Literal[""]:
        """See `Cause`: `joints` says where it acts."""
        return ""

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.explain_missing`: a column that the log has, and that is empty."""
        if self.joints and not rows["joint"].isin(self.joints).any():
            return f"the log has no traverse of joint {' or '.join(map(str, self.joints))}"
        for name in self.columns:
            for column in (name, COVARIATE_PREFIX + name):
                if column in rows and name not in STATE_NAMES and rows[column].isna().all():
                    return f"the log has no {name}"
        return None

    def bind(self, rows: pd.DataFrame, machine: Machine) -> FormulaStepCause:
        """The cause in a log.

        Raises
        ------
        InputError
            As of `bind_table`.
        """
        return bind_formula_to_log(self, rows, machine)

    def bind_table(self, law: TableLaw | ExtendedTableLaw, frame: pd.DataFrame) -> FormulaTableCause:
        """The cause in a table under a law.

        Raises
        ------
        InputError
            For unknown names with what is similar; for parameters that enter nonlinearly and have no bounds;
            for an effect that does not vanish where there should be none, or is no number.
        """
        return bind_formula_to_table(self, law, frame)


def restore_formula_cause(description: Mapping[str, Any]) -> FormulaCause:
    """The cause that `FormulaCause.describe` described.

    Raises
    ------
    InputError
        If its function cannot be imported, or its formula cannot be read.

    Examples
    --------
    >>> restore_formula_cause(FormulaCause("slip", "+ k*abs(v)", "k in N").describe()).formula
    '+ k*abs(v)'
    """
    content = dict(description)
    name, parameters = content.pop("name"), [CauseParameter(**one) for one in content.pop("parameters")]
    formula = load_function(content.pop("function")) if "function" in content else content.pop("formula")
    return FormulaCause(name, formula, parameters, **content | {"joints": tuple(content["joints"])})
