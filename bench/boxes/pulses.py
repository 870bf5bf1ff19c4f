"""The heater of a box as the board drives it: on at the begin of each window, off at its end.

Air that rises mixes by more than the gap, so pulses of heat warm a box otherwise than their mean, by 0.1 to
0.3 K on a step of control.
"""

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.virtual_board.board_config import BoardConfig

Floats = NDArray[np.float64]
WINDOW_S = BoardConfig().pwm_window_s


def relay_share(duty: float | Floats, time_s: float, dt_s: float) -> Floats:
    """Return the share of dt_s from time_s, both of the board's clock, for which the relay is closed.

    dt_s : within one window
    """
    return np.asarray(np.clip((duty * WINDOW_S - time_s % WINDOW_S) / dt_s, 0.0, 1.0))
