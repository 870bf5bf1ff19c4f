"""The room around the box: temperature, humidity and CO2 that wander, sun, draught, day and hour."""

import copy
import math

from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.noise import Wander

_DAY_S = 86400.0


class Weather:
    """Disturbances from outside at one time; `at` moves them on.

    temp_c [degC], vapour_share: relative humidity 0..1, co2_ppm, sun_w: absorbed sun [W],
    sun_light: daylight in the box [share of the lamp's full light], draught: factor on the outer film
    """

    def __init__(self, parameters: ChamberParameters, effects: Effects, seed: int) -> None:
        self._room, self._effects = parameters.room, effects
        self._draught_share = effects.room_draught * parameters.cover.draught_share
        room = parameters.room
        self._temp = Wander(seed, 1, room.wander_tau_s, 30.0)
        self._humidity = Wander(seed, 2, room.humidity_tau_s, 30.0)
        self._co2 = Wander(seed, 3, room.co2_tau_s, 30.0)
        self._air = Wander(seed, 4, parameters.cover.draught_tau_s, 30.0)
        self.at(0.0)

    def at(self, time_s: float) -> None:
        """Set every attribute to its value at `time_s`, which may not go back (see `Wander.at`)."""
        room, effects = self._room, self._effects
        hour = (room.start_hour + time_s / 3600.0) % 24.0
        swing = math.cos(2.0 * math.pi * (hour - room.warmest_hour) / 24.0)
        self.temp_c = (
            room.temp_c
            + effects.ambient_diurnal * room.diurnal_k * swing
            + effects.ambient_wander * room.wander_sd_k * self._temp.at(time_s)
        )
        wander = effects.ambient_wander
        humidity = room.rel_humidity_pct + wander * room.humidity_wander_pct * self._humidity.at(time_s)
        self.vapour_share = min(max(humidity, 5.0), 95.0) / 100.0
        self.co2_ppm = max(room.co2_ppm + wander * room.co2_wander_ppm * self._co2.at(time_s), 380.0)
        self.draught = max(1.0 + self._draught_share * self._air.at(time_s), 0.2)
        sun = effects.sun_window * self._sun(hour)
        self.sun_w, self.sun_light = room.sun_w * sun, room.sun_light * sun
        self.day = room.start_day + time_s / _DAY_S

    def _sun(self, hour: float) -> float:
        """Share of the full sun: half a sine over the hours it looks in."""
        begin, end = self._room.sun_from_hour, self._room.sun_to_hour
        return math.sin(math.pi * (hour - begin) / (end - begin)) if begin < hour < end else 0.0

    def copy(self) -> "Weather":
        """Return an independent copy with the same future."""
        twin = copy.copy(self)
        for name in ("_temp", "_humidity", "_co2", "_air"):
            setattr(twin, name, copy.copy(getattr(self, name)))
        return twin
