"""The command line: one verb a question."""

from stickslip_fit.cli._app import app, main

__all__ = ["app", "main"]
