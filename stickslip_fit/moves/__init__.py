"""The law in use: steps for a move, the tip after so many steps, when to go back to a stop."""

from stickslip_fit.moves.along import drives_along
from stickslip_fit.moves.calibrated import Calibrated, calibrated
from stickslip_fit.moves.command import StepsFor, steps_by_parameters, steps_by_truth, steps_to_command
from stickslip_fit.moves.open_loop import driven
from stickslip_fit.moves.path import Paths, straight_path
from stickslip_fit.moves.position import position_after
from stickslip_fit.moves.random_paths import random_paths
from stickslip_fit.moves.steps import Leg, Move, steps_for_move
from stickslip_fit.moves.truth import Truth
from stickslip_fit.moves.where import Drive, Whereabouts, steps_until, where_after

__all__ = [
    "Calibrated",
    "Drive",
    "Leg",
    "Move",
    "Paths",
    "StepsFor",
    "Truth",
    "Whereabouts",
    "calibrated",
    "driven",
    "drives_along",
    "position_after",
    "random_paths",
    "steps_by_parameters",
    "steps_by_truth",
    "steps_for_move",
    "steps_to_command",
    "steps_until",
    "straight_path",
    "where_after",
]
