"""The command line: one verb for each question."""

from stickslip_fit.cli._app import main
from stickslip_fit.cli.capture import app

__all__ = ["app", "main"]
