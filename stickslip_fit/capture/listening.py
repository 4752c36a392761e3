"""A joint driven to hear what it sounds like, for the ear to be tuned by."""

from __future__ import annotations

import numpy as np

from stickslip_fit.capture.clock import Clock
from stickslip_fit.capture.controller import Controller
from stickslip_fit.capture.source import Sound, Source


def listen(
    controller: Controller, source: Source, clock: Clock, joint: int, checks: int, check_every: int
) -> Sound:
    """What a joint sounds like over so many checks.

    Parameters
    ----------
    controller : Controller
    source : Source
    clock : Clock
    joint : int
    checks : int
    check_every : int
        Steps between two checks: more than 0 in direction ``+``, less in ``-``.

    Returns
    -------
    array of float32, shape (n,)
    """
    heard = []
    for _ in range(checks):
        began = clock.now()
        controller.step(joint, check_every)
        heard.append(source.read(clock.now() - began).values)
    return np.concatenate(heard)
