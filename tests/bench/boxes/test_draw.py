"""The boxes: plausible ones, of the stated variety, and nothing of the project's own models in them."""

import ast
from pathlib import Path

import numpy as np
import pytest

from bench.boxes import draw
from bench.boxes.draw import DEVELOPMENT, LOTS, SCORED, BoxFacts, draw_box, reach, scaled_reference, table

ALL = (*DEVELOPMENT, *SCORED)
KNOWN, FRESH = LOTS[0], LOTS[-1]

# They drive the boxes by the daemon and its controllers; what a box is knows nothing of them.
DRIVERS = {"__main__.py", "clairvoyant.py"}


def boxes(seeds: tuple[int, ...]) -> list[BoxFacts]:
    return [draw_box(seed) for seed in seeds]


def test_the_boxes_use_nothing_of_the_projects_models() -> None:
    files = sorted(path for path in Path(draw.__file__).parent.glob("*.py") if path.name not in DRIVERS)
    assert {"draw.py", "physics.py", "box.py"} <= {path.name for path in files}
    allowed = {
        "numpy",
        "math",
        "collections",
        "dataclasses",
        "typing",
        "functools",
        "bench",
        "firmware_protocol",
    }
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [item.name for item in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert name.split(".")[0] in allowed, path
                assert not name.startswith("bench.") or name.startswith("bench.boxes"), path
                assert f"{name.rpartition('.')[2]}.py" not in DRIVERS, path
                assert not name.startswith("firmware_") or name == "firmware_protocol.messages", path


def test_a_seed_draws_the_same_box_again() -> None:
    once = draw_box(7)
    draw_box.cache_clear()
    assert draw_box(7) == once
    assert draw_box(8) != once


def test_no_box_is_both_known_and_scored() -> None:
    assert not set(DEVELOPMENT) & set(SCORED)
    assert sorted(ALL) == sorted(seed for lot in LOTS for seed in lot)
    drawn = boxes((*KNOWN, *FRESH))
    assert len({facts.heater_w / facts.volume_m3 for facts in drawn}) == len(drawn)


def test_a_seed_below_one_is_refused() -> None:
    with pytest.raises(ValueError, match="seed 0"):
        draw_box(0)


@pytest.mark.parametrize("seed", KNOWN)
def test_a_box_is_plausible(seed: int) -> None:
    facts = draw_box(seed)
    far = reach(facts)
    assert 8.0 <= far.rise_k <= 45.0
    assert 0.02 <= facts.volume_m3 <= 1.0
    assert 20.0 <= facts.heater_w <= 400.0
    assert facts.fan == "none" or 5.0 <= 3600.0 * facts.fan_m3_s <= 200.0
    assert far.zero_c == pytest.approx(facts.room.mean_c, abs=2.0)  # wet soil cools a little
    assert 12.0 < facts.room.mean_c < 25.0
    assert abs(facts.air.bias_k) <= 0.5 and 0.0 <= facts.air.lag_s <= 120.0
    assert 0.01 <= facts.air.step_k <= 0.5
    assert max(facts.length_m, facts.width_m, facts.height_m) < 1.8


@pytest.mark.parametrize("lot", [KNOWN, FRESH])
def test_a_lot_has_the_whole_variety(lot: tuple[int, ...]) -> None:
    facts = boxes(lot)
    assert {box.heater for box in facts} == {"wire", "ptc", "ceramic", "tube", "mat"}
    assert {box.fan for box in facts} == {"exchange", "stir", "none"}
    assert sum(box.room_sensor is None for box in facts) == 3
    assert sum(box.humidity_sensor is None for box in facts) == 5
    assert sum(box.room.sun_peak_w_m2 > 0.0 for box in facts) == 9
    assert min(box.volume_m3 for box in facts) < 0.03 and max(box.volume_m3 for box in facts) > 0.7
    assert {box.air.step_k for box in facts} == {0.01, 0.0625, 0.1, 0.25, 0.5}
    assert any(box.air.lag_s == 0.0 for box in facts) and any(box.air.lag_s > 100.0 for box in facts)
    times = sorted(reach(box).quick_s for box in facts)
    assert times[0] < 180.0 and times[-1] > 2.5 * 3600.0


def test_the_time_constants_span_two_decades() -> None:
    times = [reach(facts).quick_s for facts in boxes(KNOWN)]
    assert max(times) / min(times) > 100.0


def test_lots_have_the_same_share_of_each_kind() -> None:
    kinds, heaters, fans = (
        [sorted(str(getattr(box, name)) for box in boxes(lot)) for lot in (KNOWN, FRESH)]
        for name in ("kind", "heater", "fan")
    )
    for lots in (kinds, heaters, fans):
        assert lots[0] == lots[1]


@pytest.mark.parametrize("seed", KNOWN)
def test_a_reference_is_in_reach(seed: int) -> None:
    facts = draw_box(seed)
    far = reach(facts)
    low, high = scaled_reference(np.array([0.0, 1.0]), facts)
    assert low == pytest.approx(facts.room.mean_c + 0.15 * far.rise_k)
    assert low < high <= facts.room.mean_c + 0.8 * far.rise_k + 1e-9
    assert high <= 38.0 + 1e-9  # the daemon heats no more at 40 °C


def test_the_table_has_a_row_a_box_and_80_columns() -> None:
    lines = table(KNOWN)
    assert len(lines) == len(KNOWN) + 2
    assert max(map(len, lines)) <= 80
