"""The load of a fleet: simulated rigs speak as real ones do; figures follow from what was measured."""

import json
import time
from pathlib import Path

import pytest
from history_records import eventful_tick, tick

from bench.fleet_load import (
    ENGINES,
    EngineSample,
    FleetLoad,
    Growth,
    LoadPart,
    goal_table,
    growth,
    lags,
    rig_field,
)
from fleet.ingest.state import parse_state
from fleet.ingest.tick import parse_tick
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for


def test_a_cost_is_a_line_over_the_rigs() -> None:
    line = growth([100.0, 200.0, 400.0], [1.5, 2.0, 3.0])
    assert (line.fixed, line.per_rig) == pytest.approx((1.0, 0.005))
    assert line.at(1000) == pytest.approx(6.0)
    assert line.rigs_at(2.0) == pytest.approx(200.0)
    assert Growth(1.0, -0.1).rigs_at(2.0) == float("inf")


def measured_line(cores_per_rig: dict[str, float]) -> FleetLoad:
    """A run in which each engine's cores and memory are exact lines."""
    own = FleetLoad(lags_s={name: [] for name in ENGINES})
    utc, cpu = 0.0, dict.fromkeys(ENGINES, 0.0)
    for rigs in (100, 200, 400):
        begin = utc
        for _ in range(10):
            own.samples.append(EngineSample(utc, dict(cpu), dict.fromkeys(ENGINES, 10.0 + rigs / 1000)))
            utc += 5.0
            cpu = {name: cpu[name] + 5.0 * rigs * cores_per_rig[name] for name in ENGINES}
        own.parts.append(LoadPart(rigs, begin, utc - 5.0))
    return own


def test_what_breaks_first_is_what_fills_its_cores_with_the_fewest_rigs() -> None:
    costs = {"mosquitto": 1e-5, "VictoriaMetrics": 1e-5, "ingest": 4e-5, "PostgreSQL": 2e-5}
    table = list(goal_table(measured_line(costs)))
    assert table[-1].startswith("breaks first: the CPU of ingest, at 25000 rigs")
    row = next(line for line in table if line.startswith("| ingest"))
    assert row.split(" | ")[1:4] == ["2.40", "1.0", "4.0"]


def test_lags_are_read_by_engine(tmp_path: Path) -> None:
    batch = {"utc": 5.0, "stored": 2, "numbers_s": 0.1, "database_s": 0.02, "lags_s": [1.0, 2.0]}
    empty = {"utc": 6.0, "stored": 0, "numbers_s": 0.0, "database_s": 0.01, "lags_s": []}
    (tmp_path / "journal").write_text(f"{json.dumps(batch)}\n{json.dumps(empty)}\n")
    (tmp_path / "lags").write_text("4.0 0.003\n")
    assert lags(tmp_path / "journal", tmp_path / "lags") == {
        "mosquitto": [(4.0, 0.003)],
        "VictoriaMetrics": [(5.0, 0.1)],
        "ingest": [(5.0, 1.0), (5.0, 2.0)],
        "PostgreSQL": [(5.0, 0.02), (6.0, 0.01)],
    }


@needs_mosquitto
@pytest.mark.slow
def test_simulated_rigs_speak_as_real_ones_do(tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        Listener(broker.port, "greenhouse/#") as listener,
        rig_field(tmp_path, broker.port, [tick(1), eventful_tick(2)], 1.0) as process,
    ):
        assert process.stdin is not None
        process.stdin.write("active 3\n")
        process.stdin.flush()
        topic = "greenhouse/sim-000002/history/tick"
        wait_for(lambda: len(listener.payloads(topic)) >= 2)
        listener.send("greenhouse/sim-000002/set/resend", '{"first_seq": 1, "last_seq": 1}')
        wait_for(lambda: listener.payloads("greenhouse/sim-000002/reply"))
        wait_for(lambda: [body["is_resend"] for body in listener.objects(topic)].count(1) == 1)
        said, _ = process.communicate("end\n", timeout=20.0)
        sent = json.loads(said)
        assert sorted(sent) == ["sim-000000", "sim-000001", "sim-000002"]
        wait_for(lambda: len(listener.payloads(topic)) == sent["sim-000002"] + 1)
        ticks = [parse_tick("sim-000002", payload, 0.0, time.time()) for payload in listener.payloads(topic)]
        again = next(each for each in ticks if each.is_resend)
        first = next(each for each in ticks if not each.is_resend and each.seq == 1)
        assert (again.utc, again.samples) == (first.utc, first.samples)
        assert {each.seq for each in ticks} == set(range(1, sent["sim-000002"] + 1))
        assert not any(each.unknown for each in ticks)
        assert parse_state(listener.payloads("greenhouse/sim-000002/state")[-1])["temp_air_quality"]
        assert listener.payloads("greenhouse/sim-000002/availability")[:1] == [b"online"]
        reply = listener.objects("greenhouse/sim-000002/reply")
        assert reply == [{"command": "resend", "ok": True, "queued": 1, "first_seq": 1, "last_seq": 1}]
    assert (tmp_path / "lags.txt").stat().st_size
