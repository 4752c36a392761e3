"""Drive the joints, hear the end stop, lose nothing."""

from __future__ import annotations
