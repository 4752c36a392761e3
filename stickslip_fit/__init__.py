"""Step-size laws for piezoelectric stick-slip actuators, from step counts to calibrated moves."""

from __future__ import annotations

__version__ = "0.1.0"
