"""FormulaCause: a cause of one's own, as a formula or a Python function; `ssf.Cause`.

Its first sign says what it does: ``+ expression`` adds to the response of a table or to the step size of a
log, ``* expression`` multiplies it, ``name = expression`` stands in place of a column or a coordinate, and
``steps + expression`` adds to the count of a log.

>>> FormulaCause("viscous-by-direction", "+ dFv*abs(vel)", "dFv in N s/m").names
('dFv', 'vel')
>>> FormulaCause("warm-up", "* (1 - A*expm1(-t/tau))", "A in %, tau in s", bounds={"tau": (60, 3600)}).operation
'*'

`FormulaCause.bind_table` makes it a cause of a table, see `TableCause`; `FormulaCause.bind` one of a log.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from stickslip_fit._function import load_function
from stickslip_fit.causes.cause_formula import CauseFormula
from stickslip_fit.causes.formula_table import FormulaTableCause, bind_formula_to_table
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.table_cause import ExtendedTableLaw
from stickslip_fit.laws import TableLaw


class FormulaCause(CauseFormula):
    """What a law leaves out, as a formula or a Python function; `CauseFormula` has its parameters."""

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
