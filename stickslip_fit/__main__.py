"""``python -m stickslip_fit`` is the command line."""

from __future__ import annotations

from stickslip_fit.cli import main

main()
