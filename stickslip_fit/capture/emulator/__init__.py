"""An emulated rig: controller, manipulator with hidden laws, and sound."""

from __future__ import annotations
