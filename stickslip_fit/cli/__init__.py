"""The command line: one verb for each question."""

from stickslip_fit.cli._app import app, main

__all__ = ["app", "main"]
