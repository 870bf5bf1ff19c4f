"""edge/evidence/chain.py, marks.py: a record grows by whole days, each tick is sealed once."""

import json
from pathlib import Path

import pytest
from history_records import START_UTC, store
from sealed_records import NOON_UTC, STEP_S, TICKS_A_DAY, RecordRig, sealed_tick

from edge.bundle.sign import generate_key
from edge.core.errors import DataError, RequestError
from edge.evidence.chain import seal_chain, start_chain
from edge.evidence.chain_files import DAY_S, day_name, next_day, rows_name
from edge.evidence.day_rows import SeqGap, missing_numbers, read_rows
from edge.evidence.marks import BEGIN, END, EvidenceMark, add_mark, read_marks, spans
from edge.evidence.proof import open_record


def ticks_of(rig: RecordRig, number: int) -> list[int]:
    rows = read_rows((rig.chain / rows_name(number)).read_bytes(), "rows")
    return [row.tick.seq for row in rows if row.tick is not None]


def test_each_day_is_sealed_once_it_is_over(rig: RecordRig) -> None:
    rig.live(2.2)
    assert rig.extend(0.99) == []
    (first,) = rig.extend(1.0)
    assert (first.date, first.ticks, first.after_seq) == ("2026-01-01", TICKS_A_DAY // 2, 1)
    assert rig.extend(1.5) == []
    (second,) = rig.extend(2.3)
    assert (second.ticks, second.after_seq) == (TICKS_A_DAY, first.last_seq)
    assert ticks_of(rig, 1) + ticks_of(rig, 2) == list(range(2, second.last_seq + 1))


def test_nights_without_the_timer_are_made_up_for_with_the_same_rows(rig: RecordRig, tmp_path: Path) -> None:
    other = RecordRig(tmp_path / "other")
    for one in (rig, other):
        one.live(3.0)
    for day in (1, 2, 3):
        rig.extend(day)
    other.extend(3)
    for number in (1, 2, 3):
        assert ticks_of(rig, number) == ticks_of(other, number)


def test_days_without_ticks_are_entries_too(rig: RecordRig) -> None:
    rig.live(1.0)
    days = rig.extend(4.0)
    assert [day.ticks for day in days] == [TICKS_A_DAY // 2, TICKS_A_DAY // 2, 0, 0]
    assert days[3].last_seq == days[1].last_seq


def test_a_clock_that_jumps_neither_loses_nor_repeats_a_tick(rig: RecordRig) -> None:
    """The wall clock was 1970 for three ticks, then a week ahead for one."""
    wrong = {10: 100.0, 11: 200.0, 12: 300.0, 20: NOON_UTC + 7 * DAY_S}
    rig.live(2.0, lambda one: sealed_tick(one.seq, wrong.get(one.seq, one.utc)))
    rig.extend(3.0)
    assert ticks_of(rig, 1) + ticks_of(rig, 2) + ticks_of(rig, 3) == list(range(2, 2 + 2 * TICKS_A_DAY))


def test_missing_numbers_are_listed_with_the_reason_of_the_history(rig: RecordRig) -> None:
    rig.live(1.0)
    rig.forget(5, 6)
    rig.forget(9, 9, "the queue was full")
    (day,) = rig.extend(1.0)
    assert day.gaps == (SeqGap(5, 6, ""), SeqGap(9, 9, "the queue was full"))


def test_a_reason_for_a_part_of_a_gap_is_none_for_the_whole(rig: RecordRig) -> None:
    rig.live(1.0)
    rig.forget(5, 6, "the queue was full")
    rig.forget(7, 8)
    (day,) = rig.extend(1.0)
    assert day.gaps == (SeqGap(5, 8, ""),)


@pytest.mark.parametrize(
    ("seqs", "after", "last", "missing"),
    [
        ([1, 2, 3], 0, 3, []),
        ([2, 3], 0, 3, [(1, 1)]),
        ([1, 2], 0, 4, [(3, 4)]),
        ([], 5, 5, []),
        ([], 5, 7, [(6, 7)]),
        ([8], 5, 9, [(6, 7), (9, 9)]),
    ],
)
def test_missing_numbers(seqs: list[int], after: int, last: int, missing: list[tuple[int, int]]) -> None:
    assert missing_numbers(seqs, after, last) == missing


@pytest.mark.parametrize("day", ["9999-12-31", "2026-02-30", "2026-13-01"])
def test_a_day_that_no_other_follows_is_refused(day: str) -> None:
    with pytest.raises(DataError, match=f"{day} is not a day"):
        next_day(day)


def test_a_kill_between_rows_and_entry_makes_the_day_anew(rig: RecordRig) -> None:
    rig.live(1.0)
    (rig.chain / rows_name(1)).write_bytes(b"half")
    (rig.chain / "day-0001.sig").write_bytes(b"x" * 64)
    rig.extend(1.0)
    assert open_record(rig.seal(1.0)).days[0].ticks == TICKS_A_DAY // 2


def test_a_new_history_that_counts_from_one_is_sealed_too(rig: RecordRig) -> None:
    rig.live(1.0)
    rig.extend(1.0)
    for path in rig.folder.glob("history.db*"):
        path.unlink()
    store(rig.history, *(sealed_tick(seq, START_UTC + DAY_S + seq * STEP_S) for seq in range(1, 9)))
    (day,) = rig.extend(2.0)
    assert (day.after_seq, day.ticks, day.last_seq) == (0, 8, 8)
    assert open_record(rig.seal(2.0)).days[1].history_id != open_record(rig.seal(2.0)).start.history_id


def test_a_clock_that_cannot_be_right_seals_nothing(rig: RecordRig) -> None:
    rig.live(1.0)
    with pytest.raises(RequestError, match=r"2026-01-01 is next and the clock says 2036"):
        rig.extend(3652.0)
    assert not (rig.chain / day_name(1)).exists()
    assert rig.extend(-3000.0) == []


def test_a_record_is_started_once_and_not_extended_before(rig: RecordRig) -> None:
    store(rig.history, sealed_tick(1, NOON_UTC))
    with pytest.raises(RequestError, match="no record has begun"):
        rig.extend(1.0)
    start_chain(rig.chain, rig.history, rig.key, NOON_UTC)
    with pytest.raises(RequestError, match="has begun here already"):
        start_chain(rig.chain, rig.history, rig.key, NOON_UTC)


def test_another_key_cannot_go_on_with_a_record(rig: RecordRig, tmp_path: Path) -> None:
    rig.live(1.0)
    generate_key(tmp_path / "other.pem")
    rig.key = tmp_path / "other.pem"
    with pytest.raises(DataError, match=r"start\.sig: the signature is by none of the 1 trusted keys"):
        rig.extend(1.0)


def test_the_newest_files_of_a_rig_that_were_spoilt_are_not_built_upon(rig: RecordRig) -> None:
    rig.live(2.0)
    rig.extend(1.0)
    entry = rig.chain / day_name(1)
    entry.write_text(entry.read_text().replace("2026-01-01", "2026-01-02"))
    with pytest.raises(DataError, match=r"day-0001\.sig: the signature"):
        rig.extend(2.0)
    with pytest.raises(DataError, match=r"day-0001\.sig: the signature"):
        seal_chain(rig.chain, rig.key, rig.folder / "out.zip", NOON_UTC)


# marks


def at(hours: float, what: str, edge: str) -> EvidenceMark:
    return EvidenceMark(NOON_UTC + 3600.0 * hours, what, edge)


def test_marks_are_sealed_with_the_day_that_they_are_made_on(rig: RecordRig) -> None:
    rig.live(2.0, marks=[at(1, "hands", BEGIN), at(2, "hands", END)])
    rig.extend(1.0)
    add_mark(rig.chain, at(14, "usb_pulled", BEGIN))
    first, second = rig.extend(2.0)[0], open_record(rig.seal(2.0)).days
    assert [day.marks for day in second] == [2, 3]
    assert first == second[1]


def test_marks_that_contradict_those_before_are_refused(rig: RecordRig) -> None:
    rig.live(1.0, marks=[at(1, "hands", BEGIN)])
    for mark, why in (
        (at(2, "hands", BEGIN), "hands has begun already"),
        (at(2, "usb_pulled", END), "usb_pulled has not begun"),
        (at(0, "hands", END), "the clock is before the last mark"),
    ):
        with pytest.raises(RequestError, match=why):
            add_mark(rig.chain, mark)
    assert len(read_marks(rig.chain)) == 1


def test_a_spoilt_line_of_marks_is_named(rig: RecordRig) -> None:
    rig.live(1.0, marks=[at(1, "hands", BEGIN)])
    path = rig.chain / "marks.jsonl"
    path.write_text(path.read_text() + json.dumps({"utc": 1.0, "what": "lunch", "edge": "begin"}) + "\n")
    with pytest.raises(DataError, match=r"marks\.jsonl: line 2: what: 'lunch' is none of"):
        read_marks(rig.chain)


def test_a_span_that_was_left_open_ends_with_the_record() -> None:
    found = spans([at(1, "hands", BEGIN), at(2, "usb_pulled", BEGIN), at(3, "usb_pulled", END)], 1e12)
    assert [(span.what, span.end_utc) for span in found] == [
        ("hands", 1e12),
        ("usb_pulled", NOON_UTC + 3 * 3600.0),
    ]
    with pytest.raises(DataError, match="ends without a begin"):
        spans([at(1, "hands", END)], 1e12)
