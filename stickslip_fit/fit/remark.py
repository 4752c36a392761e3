"""What a person should know about a fit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Remark:
    """Something a person should know about a parameter or a whole group.

    Attributes
    ----------
    flag : str
        ``not_identified``, ``not_converged``, ``at_bound``, ``few_replicates``, ``repeatability_doubted`` or
        ``outlier``.
    joint : int
    direction, session : str
        An empty session stands for all of them.
    parameters : tuple of str
        Names of the parameters concerned.
    message : str
        What is the matter and what to do.
    """

    flag: str
    joint: int
    direction: str
    session: str
    parameters: tuple[str, ...]
    message: str
