"""bench/agreement.py and bench/reliability.py: what is compared, and what is counted."""

from pathlib import Path

import numpy as np
import pytest
from training_runs import box_run

from bench.agreement import _begun_anywhere, _half, disagreement
from bench.reliability import _draw, _lines, main
from edge.diagnosis.python import Run, Twin
from edge.twin.twin_file import read_twin_file

TWIN = """
effects:
  wall_loss: {UA: {fit: true, start: 4.0}}
  extra_capacity: {kC: {value: 10.0, rel_sd: 0.3}}
"""


def answer(tau_s: float = 60.0, name: str = "heater_lag", ua: float = 4.0) -> dict[str, object]:
    return {
        "effects": [
            {"name": name, "parameters": {"tau": {"value": tau_s, "low": tau_s - 10.0, "high": tau_s + 10.0}}}
        ],
        "values": {"effects.wall_loss.UA": {"value": ua, "low": ua - 0.5, "high": ua + 0.5}},
    }


def test_answers_agree_where_names_are_the_same_and_values_within_each_others_intervals() -> None:
    assert disagreement(answer(), answer(tau_s=69.0, ua=4.4)) == ""
    assert disagreement(answer(), answer(name="sensor_lag")) == "heater_lag and sensor_lag"
    assert disagreement(answer(), answer(tau_s=71.0)).startswith("heater_lag.tau 60 is not in 61 to 81")
    assert "UA 4 is not in" in disagreement(answer(), answer(ua=4.6))


def test_only_values_to_be_fitted_begin_anywhere(tmp_path: Path) -> None:
    (tmp_path / "twin.yaml").write_text(TWIN)
    twin = Twin(read_twin_file(tmp_path / "twin.yaml"))
    draw = np.random.default_rng(1)
    starts = [_begun_anywhere(twin, draw).file.values() for _ in range(50)]
    found = [values["effects", "wall_loss", "UA"] for values in starts]
    assert all(0.39 < value.value < 40.1 and value.fit for value in found)
    assert max(value.value for value in found) > 5.0 * min(value.value for value in found)
    assert {values["effects", "extra_capacity", "kC"].value for values in starts} == {10.0}


def test_halves_share_no_row_and_none_that_validates() -> None:
    run = Run("a", box_run(1))  # of its 90 rows the last fifth validates
    first, second = _half(run, True), _half(run, False)
    assert (len(first), len(second)) == (36, 36)
    assert "validate_from_s" not in {**first.facts, **second.facts}
    whole = run.content.columns["temp_air_c"][:72]
    assert np.concatenate([part.columns["temp_air_c"] for part in (first, second)]) == pytest.approx(whole)


def test_what_was_said_stands_beside_what_held() -> None:
    told = [(0.97, True)] * 9 + [(0.97, False), (0.7, True), (0.7, False)]
    text = "\n".join(_lines("foreign", told))
    assert "foreign: 12 names" in text
    assert "0.95 to 1.00: said 0.97, held 0.90" in text
    assert "of 10" in text


@pytest.mark.parametrize("right", [True, False])
def test_names_that_were_all_right_or_all_wrong_are_drawn(tmp_path: Path, right: bool) -> None:
    _draw({"foreign": [(0.97, right)] * 3}, tmp_path / "diagram.png")
    assert (tmp_path / "diagram.png").stat().st_size > 1000


def test_a_place_without_names_draws_an_empty_diagram(tmp_path: Path) -> None:
    (tmp_path / "dev" / "truth").mkdir(parents=True)
    assert main([f"foreign={tmp_path / 'dev'}", "--out", str(tmp_path / "diagram.png")]) == 0
    assert (tmp_path / "diagram.png").stat().st_size > 1000
