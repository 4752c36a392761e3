"""Fixtures for figures: logs fitted as for a report."""

from tests.reporting.conftest import fitted, read_page, reported, whole

__all__ = ["fitted", "read_page", "reported", "whole"]
