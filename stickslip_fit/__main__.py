"""``python -m stickslip_fit`` is the command line."""

from stickslip_fit.cli import main

main()
