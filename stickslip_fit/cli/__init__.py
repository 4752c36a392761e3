"""The command line: one verb a question."""

from stickslip_fit.cli.app import app, main

__all__ = ["app", "main"]
