"""A manipulator that is not there: it steps, stops and sounds like one."""

from __future__ import annotations
