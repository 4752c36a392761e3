"""The law in use: steps for a move, the tip after so many steps, when to go back to a stop."""

from stickslip_fit.moves.accuracy_map import AccuracyMap, map_accuracy
from stickslip_fit.moves.arm import CalibratedArm, calibrated_arm
from stickslip_fit.moves.dead_reckoning import (
    DriveCommand,
    PoseEstimate,
    dead_reckon,
    position_after,
    steps_before_recalibration,
)
from stickslip_fit.moves.drives import read_drives
from stickslip_fit.moves.incremental import DriveReckoning
from stickslip_fit.moves.path import TipPaths, draw_random_paths, straight_path
from stickslip_fit.moves.planning import (
    MovePlan,
    MoveSegment,
    StepModel,
    TrueLaws,
    plan_move,
    plan_steps,
    simulate_open_loop,
    step_model_from_parameters,
)
from stickslip_fit.moves.prediction import predict

__all__ = [
    "AccuracyMap",
    "CalibratedArm",
    "DriveCommand",
    "DriveReckoning",
    "MovePlan",
    "MoveSegment",
    "PoseEstimate",
    "StepModel",
    "TipPaths",
    "TrueLaws",
    "calibrated_arm",
    "dead_reckon",
    "draw_random_paths",
    "map_accuracy",
    "plan_move",
    "plan_steps",
    "position_after",
    "predict",
    "read_drives",
    "simulate_open_loop",
    "step_model_from_parameters",
    "steps_before_recalibration",
    "straight_path",
]
