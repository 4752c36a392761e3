"""The report's figures: one idea per file, data in, Figure out."""

from __future__ import annotations
