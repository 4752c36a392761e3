"""What was measured or shall be: the campaign log, read, checked and given its history."""

from stickslip_fit.logs.history import add_history
from stickslip_fit.logs.log import Log, write_log
from stickslip_fit.logs.reader import read_log

__all__ = ["Log", "add_history", "read_log", "write_log"]
