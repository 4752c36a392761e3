"""The law in use: steps for a move, the tip after so many steps, when to go back to a stop."""

from stickslip_fit.moves.calibrated import Calibrated, calibrated
from stickslip_fit.moves.position import position_after
from stickslip_fit.moves.steps import Leg, Move, steps_for_move
from stickslip_fit.moves.where import Drive, Whereabouts, steps_until, where_after

__all__ = [
    "Calibrated",
    "Drive",
    "Leg",
    "Move",
    "Whereabouts",
    "calibrated",
    "position_after",
    "steps_for_move",
    "steps_until",
    "where_after",
]
