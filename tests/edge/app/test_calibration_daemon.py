"""The daemon on a virtual board whose air sensor has a gain and an offset, calibrated in water."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.board.virtual_rig import settings_in
from edge.config import loading as config
from edge.core.messages import TickRecord
from edge.storage import FactBook
from edge.storage.facts import FactKind
from edge.storage.runs import export_stretches
from firmware_protocol.virtual_board.board_config import RIG_PARTS
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.plant import Plant
from training.lab import Lab

pytestmark = pytest.mark.slow

GAIN, OFFSET = 1.04, -1.1  # true = GAIN * raw + OFFSET, but for the bias that the chamber's sensor has itself
SCRIPT: dict[int, list[dict[str, Any]]] = {  # after so many ticks of a minute
    5: [{"do": "calibrate_point", "signal": "temp_air", "true_value": 22.0}],  # it heats
    10: [{"do": "maintenance", "minutes": 60}],
    20: [{"do": "calibrate_point", "signal": "temp_air", "true_value": 32.0}],  # ice water in °F
    21: [{"do": "calibrate_point", "signal": "temp_air", "true_value": 0.0}],
    50: [{"do": "calibrate_point", "signal": "temp_air", "true_value": 34.0}],
    60: [{"do": "apply_calibration", "signal": "temp_air"}, {"do": "maintenance", "minutes": 0}],
}
WATER_C = {11: 0.0, 40: 34.0, 52: None}  # the sensor is held into it, None: it is back in the box
APPLIED = 61  # first tick that reads by it


class CrookedChamber(Chamber):
    """A chamber whose air sensor a person can hold into water, and which shows it wrong."""

    water_c: float | None = None

    def sense(self) -> dict[str, float]:
        """Return the sensors' present values."""
        found = super().sense()
        if self.water_c is not None:
            found["temp_air_c"] += self.water_c - self.truth()["temp_sensor_c"]
        return found | {"temp_air_c": (found["temp_air_c"] - OFFSET) / GAIN}


class Script:
    """Gives the orders of SCRIPT and keeps the answers."""

    def __init__(self, chamber: CrookedChamber) -> None:
        self.chamber, self.lab, self.answers = chamber, None, []

    def tick(self, record: TickRecord) -> None:
        """Act after a tick, in the control thread, which answers later."""
        self.chamber.water_c = WATER_C.get(record.seq, self.chamber.water_c)
        for order in SCRIPT.get(record.seq, []):
            self.lab._daemon._loop._rig.inbox.post(order, self.answers.append)


def test_two_points_in_water_correct_the_sensor_for_good(tmp_path: Path) -> None:
    parameters, effects = load(None)
    chamber = CrookedChamber(parameters, effects, 1)
    script = Script(chamber)
    settings = settings_in(tmp_path, config.default())
    with Lab(
        settings,
        board="here",
        plant=Plant(chamber, RIG_PARTS),
        folder=tmp_path,
        with_truth=True,
        on_tick=script.tick,
    ) as lab:
        script.lab = lab
        lab.run(minutes=75)
        saved = json.loads((tmp_path / "state.json").read_text())["operation"]
        lab.run(minutes=10)  # after a power cut
    refused = [answer["error"] for answer in script.answers if not answer["ok"]]
    assert len(refused) == 2, script.answers
    assert "the heater is on" in refused[0]
    assert "Is the value in °C?" in refused[1]
    (found,) = saved["calibrations"]
    assert "points" not in saved
    assert found["gain"] == pytest.approx(GAIN, abs=0.004)
    assert found["offset"] == pytest.approx(OFFSET - parameters.sensors.air_bias_k, abs=0.06)
    error_k = lab.columns()["temp_air_c"] - lab.columns()["sensor_air_c"]
    assert np.mean(error_k[2:10]) > 0.1  # read wrong before, at 22 to 28 °C
    assert np.abs(error_k[APPLIED:]).max() < 0.25  # noise and steps of 0.1 K remain
    events = [event for record in lab.history[APPLIED - 1 :] for event in record.events]
    assert not [event for event in events if event.severity.value != "info"], events
    assert {"calibration.changed", "calibration.holds"} <= {event.key for event in events}
    assert len(lab.history) == 85
    (learnt,) = FactBook(settings.history.path, lambda: 0.0).newest_first()
    assert (learnt.kind, learnt.text[:16]) == (FactKind.LEARNT, "temp_air is now ")
    # An export for a fit never crosses the moment.
    assert [len(run) for run in export_stretches(settings.history.path)] == [APPLIED - 1, 15, 10]
