"""docs/hardware/protocol.md holds the numbers that reports are made with."""

from pathlib import Path

import pytest

from edge.evidence import protocol
from edge.evidence.protocol import FAULTS, THRESHOLDS, protocol_sha256
from edge.formats.table import Table
from edge.safety import thermal_supervision
from edge.tick.faults import FAILURES

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
