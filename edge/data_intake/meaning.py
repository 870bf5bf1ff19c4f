"""Which of our columns a stranger's column may be, by its name."""

import re
from collections.abc import Mapping, Sequence

from edge.data_intake.units import TARGETS


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


# Words of a name that speak for a target, and against it; a name is split at anything but letters and digits.
FOR: Mapping[str, frozenset[str]] = {
    "temp_air_c": _words("temp temperature temperatur t t1 tin inside indoor air luft box chamber"),
    "temp_ambient_c": _words("ambient room raum outside outdoor tamb tout ext external text"),
    "heater_duty": _words("heater heat heating heizung duty q1 power pwm output hea"),
    "fan_on": _words("fan vent ventilation blower"),
    "rel_humidity_pct": _words("rh humidity hum feuchte"),
    "co2_ppm": _words("co2"),
    "light": _words("light led lamp"),
    "soil_moisture": _words("soil"),
    "tank_level": _words("tank"),
    "door_open": _words("door lid window"),
    "solar_w_m2": _words("solar sun irradiance radiation ghi globalstrahlung"),
}
ELSEWHERE = _words("ambient room raum outside outdoor tamb tout ext set setpoint reference target soil")
AGAINST: Mapping[str, frozenset[str]] = {
    "temp_air_c": ELSEWHERE | _words("heater plate t2"),
    "heater_duty": _words("temp temperature fan set setpoint"),
    "fan_on": _words("rpm temp"),
    "rel_humidity_pct": ELSEWHERE,
}
_NONE = frozenset[str]()
DEGREES = ("c", "degc", "celsius", "f", "degf", "k")  # a name that ends so is a temperature
TIME_WORDS = (
    "time",
    "timestamp",
    "date",
    "datetime",
    "zeit",
    "datum",
    "epoch",
    "seconds",
    "sec",
    "ts",
    "unix",
)


def words_of(name: str) -> list[str]:
    """`T_in [°C]` is t, in, c."""
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return [word for word in re.split(r"[^a-z0-9%]+", apart.lower()) if word]


def is_time(name: str) -> bool:
    """Return whether a name sounds like a time."""
    return any(word in TIME_WORDS for word in words_of(name))


def propose(names: Sequence[str]) -> dict[str, list[str]]:
    """For each target the columns that may be it, the likeliest first; none is the first of two."""
    scores = {target: {name: _score(name, target) for name in names} for target in TARGETS}
    found: dict[str, list[str]] = {}
    taken: set[str] = set()
    for target in sorted(TARGETS, key=lambda target: -max(scores[target].values(), default=0.0)):
        ranked = sorted(
            (name for name in names if scores[target][name] > 0.0), key=lambda name: -scores[target][name]
        )
        free = [name for name in ranked if name not in taken]
        if free:
            taken.add(free[0])
            found[target] = [free[0], *(name for name in ranked if name != free[0])]
    return {target: found[target] for target in TARGETS if target in found}


def _score(name: str, target: str) -> float:
    """How many words speak for it; none where one is against it."""
    if name == target:
        return 10.0
    words = words_of(name)
    if any(word in AGAINST.get(target, _NONE) for word in words):
        return 0.0
    row = FOR.get(target, _NONE)
    unit = 0.5 if target == "temp_air_c" and words and words[-1] in DEGREES else 0.0
    return unit + float(sum(word in row for word in words))
