"""Long recordings in pieces: where rows are missing for long, and what lasts for days."""

import math
from itertools import pairwise

import numpy as np

from edge.formats.run_file import RecordedRun, cut

GAP_S = 600.0  # without rows for longer, nothing is known of what the heater did meanwhile
WHOLE_S = 48 * 3600.0  # in steps of a minute: what is no longer stays one, as long as its steps are slower
LONGEST_S = 24 * 3600.0  # of the parts of what is longer, as time grows with the longest of them
USUAL_STEP_S = 60.0


def pieces(run: RecordedRun, step_s: float = USUAL_STEP_S) -> list[RecordedRun]:
    """Cut a run where rows are more than GAP_S apart, and cut what is longer than WHOLE_S into equal parts.

    What a body had stored is not known where a part begins.

    step_s : of the twin; where it is more than a minute, gaps and parts may be longer by as much
    Each piece begins at time 0 and says when that was. No row is in two of them.
    """
    slower = max(1.0, step_s / USUAL_STEP_S)
    time_s = run.columns["time_s"]
    starts = [0, *(np.flatnonzero(np.diff(time_s) > GAP_S * slower) + 1).tolist(), len(time_s)]
    found = []
    for begin, end in pairwise(starts):
        lasts_s = (time_s[end - 1] - time_s[begin]) / slower
        parts = 1 if lasts_s <= WHOLE_S else math.ceil(lasts_s / LONGEST_S)
        bounds = np.linspace(begin, end, parts + 1).round().astype(int)
        found += [cut(run, int(first), int(last)) for first, last in pairwise(bounds)]
    return [piece for piece in found if len(piece)]
