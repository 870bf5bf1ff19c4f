"""Numbers as a person reads them: three digits, a dash where there is none."""

import math

DASH = "–"
EVEN_NATS = math.log(1.05)
SURE_NATS = math.log(100.0)  # odds beyond it say more of the noise model than of the box


def number(value: float | None, digits: int = 3) -> str:
    """`digits` significant digits, no more decimals than they need: 1235, 18.3, 0.00081."""
    if value is None:
        return DASH
    size = abs(value)
    if size != 0.0 and not 1e-5 <= size < 1e7:
        return f"{value:.{digits - 1}e}"
    exponent = int(f"{size:.{digits - 1}e}".partition("e")[2])  # as it is rounded: of 9.99 to two digits 1
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def kelvin(value: float | None) -> str:
    """Format an error: hundredths of a kelvin, thousandths below a tenth, whole kelvins from a hundred on."""
    if value is None:
        return DASH
    decimals = 3 if abs(value) < 0.0995 else 2 if abs(value) < 99.95 else 0
    return f"{value:.{decimals}f}"


def percent(share: float | None) -> str:
    """Format a share of 1 as `71 %`; never 0 or 100 unless exact."""
    if share is None:
        return DASH
    if 0.0 < share < 0.005:
        return "< 1 %"
    return "> 99 %" if 0.995 <= share < 1.0 else f"{100.0 * share:.0f} %"


def plus_minus(value: float | None, error: float | None) -> str:
    """Format a value with its standard error, to the error's digits: `-38 ± 3`, `2.31 ± 0.14`."""
    if value is None or not error:
        return number(value)
    exponent = math.floor(math.log10(error))
    decimals = max(0, (1 if error < 2.95 * 10.0**exponent else 0) - exponent)
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def nats(value: float | None) -> str:
    """Format a log likelihood, a gain or log odds [nat], at most to tenths."""
    if value is None:
        return DASH
    return f"{value + 0.0:.{1 if abs(value) < 99.95 else 0}f}".replace("-0.0", "0.0")


def odds(log_odds: float | None) -> str:
    """Log odds [nat] in words: `12 to 1`, `1 to 3`."""
    if log_odds is None:
        return DASH
    if abs(log_odds) < EVEN_NATS:
        return "even"
    if abs(log_odds) > SURE_NATS:
        return "more than 100 to 1" if log_odds > 0.0 else "less than 1 to 100"
    times = number(math.exp(abs(log_odds)), 2)
    return f"{times} to 1" if log_odds >= 0.0 else f"1 to {times}"


def probability(value: float | None) -> str:
    """Format a probability as `0.93`, an unknown one as a dash."""
    return DASH if value is None else f"{value:.2f}"


def clock(seconds: float) -> str:
    """`2:51:50`."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


def duration(seconds: float) -> str:
    """`45 s`, `30 min`, `2.5 h`, `14 d`."""
    for unit_s, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * unit_s:
            return f"{number(seconds / unit_s, 2)} {unit}"
    return f"{number(seconds, 2)} s"
