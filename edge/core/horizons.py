"""The scored horizons of a forecast, and how many control steps each has."""

HORIZONS_MIN = (1, 5, 15, 30, 60)
STEPS_MAX = 100  # of the 120 rows of the history: a forecast that ends now must find where it began
_OFF_MAX = 0.1  # share of a horizon that whole steps may be off


def steps_of(step_s: float) -> dict[int, int]:
    """Control steps of each horizon that fits them, by the horizon in minutes, shortest first.

    A horizon is left out where no number of steps comes within a tenth of it, or where it needs more than
    STEPS_MAX: at steps of 10 s the longest is 15 minutes.
    """
    found = {}
    for minutes in HORIZONS_MIN:
        steps = round(60.0 * minutes / step_s)
        if 1 <= steps <= STEPS_MAX and abs(steps * step_s / (60.0 * minutes) - 1.0) <= _OFF_MAX:
            found[minutes] = steps
    return found
