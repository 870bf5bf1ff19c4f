"""`greenhouse evidence`, its report, and the page that holds the numbers that reports are made with."""

import re
import time
from pathlib import Path

import pytest
from sealed_records import NOON_UTC, RecordRig, sealed_tick

from edge.__main__ import main
from edge.evidence import chain, protocol, report
from edge.evidence.chain_files import DAY_S
from edge.evidence.proof import open_record
from edge.evidence.protocol import FAULTS, THRESHOLDS, protocol_sha256
from edge.evidence.record_table import RecordCollector
from edge.formats.table import Table
from edge.safety import thermal_supervision
from edge.tick.faults import FAILURES


@pytest.fixture
def config(rig: RecordRig) -> Path:
    path = rig.folder / "edge.yaml"
    path.write_text(
        f"history: {{path: {rig.history}}}\n"
        f"bundle: {{path: {rig.folder / 'bundles'}, signing_key: {rig.key}}}\n"
    )
    return path


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The clock that the command reads."""
    now = [NOON_UTC]
    monkeypatch.setattr(time, "time", lambda: now[0])
    return now


def test_a_record_from_start_to_report(
    rig: RecordRig, config: Path, wall: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    from history_records import store

    store(rig.history, sealed_tick(1, NOON_UTC - 60.0))
    words = ["--config", str(config)]
    assert main(["evidence", "start", *words]) == 0
    wall[0] += 60.0
    assert main(["evidence", "mark", "hands", "begin", "--text", "watering", *words]) == 0
    wall[0] += 60.0
    assert main(["evidence", "mark", "hands", "end", *words]) == 0
    store(rig.history, *(sealed_tick(2 + k, NOON_UTC + 1800.0 * k) for k in range(80)))
    assert main(["evidence", "extend", *words]) == 0
    assert "no day is over" in capsys.readouterr().out
    wall[0] = NOON_UTC + 2 * DAY_S
    assert main(["evidence", "extend", *words]) == 0
    said = capsys.readouterr().out
    head = re.search(r"^head ([0-9a-f]{64})$", said, re.MULTILINE)
    assert head is not None and "2026-01-01  24 ticks, 0 missing" in said
    out, page = rig.folder / "record.zip", rig.folder / "report.html"
    assert main(["evidence", "seal", "--out", str(out), *words]) == 0
    key = str(rig.key.with_suffix(".pub"))
    assert main(["evidence", "verify", str(out), "--key", key, "--head", head[1]]) == 0
    assert "changed       nothing" in capsys.readouterr().out
    assert main(["evidence", "report", str(out), "--out", str(page)]) == 0
    text = page.read_text()
    assert "Not finished" in text and "1 of 30 days" in text and "<svg" in text
    assert "watering" not in text and "signing_key" in text  # the settings of the last day, folded


def test_a_record_that_does_not_hold_is_refused_in_one_line(
    rig: RecordRig, capsys: pytest.CaptureFixture[str]
) -> None:
    out = rig.live(1.0).seal(1.0)
    out.write_bytes(out.read_bytes()[:-30])
    for words in (["verify", str(out)], ["report", str(out), "--out", str(rig.folder / "r.html")]):
        assert main(["evidence", *words]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"greenhouse evidence: {out}: no record archive, or damaged")
    assert not (rig.folder / "r.html").exists()


def test_without_a_key_the_way_to_one_is_said(
    rig: RecordRig, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config.write_text(f"history: {{path: {rig.history}}}\n")
    assert main(["evidence", "start", "--config", str(config)]) == 2
    assert "greenhouse bundle key FILE" in capsys.readouterr().err


def test_a_phase_that_the_protocol_does_not_know_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["evidence", "mark", "lunch", "begin"])
    assert "reference_1" in capsys.readouterr().err


def test_a_record_of_other_thresholds_is_not_reported(
    rig: RecordRig, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(chain, "protocol_sha256", lambda: "0" * 64)
    out = rig.live(1.0).seal(1.0)
    assert main(["evidence", "report", str(out), "--out", str(rig.folder / "r.html")]) == 2
    assert "start.json: the record began with other thresholds" in capsys.readouterr().err


def test_text_from_a_rig_is_escaped_in_the_page(rig: RecordRig) -> None:
    rig.live(2.5)
    rig.forget(30, 31, "<script>alert(1)</script>")
    collector = RecordCollector()
    record = open_record(rig.seal(3.0), see=collector.see)
    page, lines = report.report(record, collector.table(record))
    assert "<script>" not in page and "&lt;script&gt;" in page
    proof = list(report.proof_lines(record))
    assert "NO REASON" not in "".join(proof)
    assert all(len(line) <= 80 for line in (*lines, *proof))


def test_a_tick_of_a_clock_gone_wild_does_not_end_the_report(rig: RecordRig) -> None:
    wild = {30: 1e18, 40: 0.0}
    rig.live(2.5, lambda one: sealed_tick(one.seq, wild.get(one.seq, one.utc)))
    collector = RecordCollector()
    record = open_record(rig.seal(3.0), see=collector.see)
    page, _ = report.report(record, collector.table(record))
    assert "<svg" in page


def test_the_page_needs_no_matplotlib(rig: RecordRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    collector = RecordCollector()
    record = open_record(rig.live(2.5).seal(3.0), see=collector.see)
    page, _ = report.report(record, collector.table(record))
    assert "<svg" not in page and "Thresholds" in page


PAGE = Path(__file__).parents[3] / "docs" / "hardware" / "protocol.md"


CRITERIA = Table(
    "",
    ("key", "measured over the record", "success"),
    tuple((threshold.key, threshold.text, threshold.rule) for threshold in THRESHOLDS),
    words=True,
)
PROVOKED = Table(
    "",
    ("mark", "what you do", "event that names it", "within"),
    tuple(
        (fault.name, fault.how, " or ".join(f"`{key}`" for key in fault.keys), f"{fault.within_min:g} min")
        for fault in FAULTS
    ),
    words=True,
)


@pytest.mark.parametrize(("name", "table"), [("faults", PROVOKED), ("thresholds", CRITERIA)])
def test_the_page_has_the_numbers_of_the_code(name: str, table: Table) -> None:
    _, after = PAGE.read_text().split(f"<!-- {name} -->\n")
    assert after.split(f"<!-- /{name} -->")[0].splitlines() == list(table.markdown())


def test_the_events_that_name_a_fault_are_events_of_the_daemon() -> None:
    source = "".join(
        (Path(__file__).parents[3] / "edge" / name).read_text()
        for name in ("board/board.py", "storage/storage.py")
    )
    thermal = {thermal_supervision.HEATER_NO_EFFECT, thermal_supervision.FAN_NO_EFFECT}
    for key in (key for fault in FAULTS for key in fault.keys):
        if key.startswith("safety."):
            assert key.removeprefix("safety.") in thermal
        else:
            assert key in FAILURES or f'"{key}"' in source, key


def test_any_other_number_is_another_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    before = protocol_sha256()
    monkeypatch.setattr(protocol, "DAY_SHARE", 0.9)
    assert protocol_sha256() != before
    monkeypatch.undo()
    assert protocol_sha256() == before


def test_a_value_that_is_no_number_meets_no_threshold() -> None:
    assert not any(one.passes(float("nan")) for one in THRESHOLDS)
