"""Random fault scenarios of the whole daemon: python -m bench.attack.scenarios --seed S --count N.

`violations` holds the invariants of every scenario, whatever was drawn. Each check returns its violations as
sentences.
"""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.attack.lives import Outcome
from bench.attack.lives import run as live
from bench.attack.part import TrialResult, main_of
from bench.attack.plan import SILENT, draw
from edge.core.sweep import sweep
from tests.support.watched_clock import Look

LEASE_S = 10.0  # firmware_protocol/PROTOCOL.md: outputs fall so long after the host's last word
OBEYED_S = 1.0  # a stop is in force this soon
LOOK_S = 0.5  # truth is known only so often
REPAIRED_S = 12.0  # a line that works again has its link again: greeting, retries, one lease
MISSING_MAX = 20_000  # longest gap that an unclean end may leave
LINE = ("drop_bytes", "duplicate_bytes", "flip_bits", "garbage", "delay", "clock_drift", *SILENT)
BOARD = ("reset", "brown_out", "clock_wrap")
WORKERS = os.cpu_count() or 1


@dataclass(frozen=True, slots=True)
class Span:
    """From `begin_s` to `end_s`."""

    begin_s: float
    end_s: float

    def holds(self, time_s: float) -> bool:
        """Return whether the time lies inside."""
        return self.begin_s <= time_s <= self.end_s


def violations(outcome: Outcome) -> list[str]:
    """Everything that should not have been, in words; empty when all is well."""
    return [
        *_check_end(outcome),
        *_heat_after_silence(outcome),
        *_stops(outcome),
        *_numbers(outcome),
    ]


def _check_end(outcome: Outcome) -> Iterator[str]:
    """Check that a daemon ended when told to, and only then."""
    for number, lived in enumerate(outcome.lives):
        expected = -9 if lived.life.killed else 0
        if lived.exit_code != expected:
            last = lived.output.strip().splitlines()[-1:] or [""]
            yield f"life {number} ended with {lived.exit_code}, not {expected}: {last[0]}"
        elif "Traceback" in lived.output:
            yield f"life {number} printed a traceback: {lived.output.strip().splitlines()[-1]}"


def _heat_after_silence(outcome: Outcome) -> Iterator[str]:
    """Heat never longer than one lease after communication is lost."""
    for span in silences(outcome):
        late = [
            look for look in outcome.looks
            if span.begin_s + LEASE_S + LOOK_S < look.time_s <= span.end_s and look.heater_pin
        ]  # fmt: skip
        if late:
            yield (
                f"the heater pin is on at {late[0].time_s:.1f} s, nothing heard since {span.begin_s:.1f} s"
            )


def silences(outcome: Outcome) -> list[Span]:
    """Stretches in which no word of a host can reach the board."""
    spans = []
    for fault in outcome.plan.faults:
        if fault["name"] in SILENT and fault.get("direction") != "to_host":
            spans.append(Span(fault["start_s"], fault["start_s"] + fault["duration_s"]))
    for lived, after in zip(outcome.lives, [*outcome.lives[1:], None], strict=True):
        end_s = outcome.looks[-1].time_s if after is None else after.begin_s
        spans.append(Span(lived.end_s + LOOK_S, end_s))
    return [Span(span.begin_s + _in_flight_s(outcome, span.begin_s), span.end_s) for span in spans]


def _in_flight_s(outcome: Outcome, time_s: float) -> float:
    """How long words of the host are still on a slow line."""
    delays = [
        fault["delay_s"]
        for fault in outcome.plan.faults
        if fault["name"] == "delay" and fault["direction"] != "to_host"
        and fault["start_s"] <= time_s <= fault["start_s"] + fault["duration_s"] + fault["delay_s"]
    ]  # fmt: skip
    return float(sum(delays))


def _stops(outcome: Outcome) -> Iterator[str]:
    """After an acknowledged stop or maintenance no actuator moves until it is released, over all restarts."""
    for span in stopped_spans(outcome):
        for look in outcome.looks:
            is_late = span.begin_s + OBEYED_S + LOOK_S < look.time_s < span.end_s
            if is_late and look.pins_on and not _is_excused(outcome, span, look):
                on = ", ".join(look.pins_on)
                yield f"{on} on at {look.time_s:.1f} s, stopped at {span.begin_s:.1f} s"
                break


def stopped_spans(outcome: Outcome) -> list[Span]:
    """From each acknowledged stop or maintenance to its end."""
    last_s = outcome.looks[-1].time_s
    spans: list[Span] = []
    stop: float | None = None
    maintenance: Span | None = None
    for given in outcome.orders:
        do = given.request["do"] if given.reply.get("ok") else ""
        if do == "emergency_stop" and stop is None:
            stop = given.time_s
        elif do == "release_emergency_stop" and stop is not None:
            spans.append(Span(stop, given.time_s))
            stop = None
        elif do == "maintenance":
            if maintenance is not None:
                spans.append(Span(maintenance.begin_s, min(maintenance.end_s, given.time_s)))
            maintenance = Span(given.time_s, given.time_s + 60.0 * given.request["minutes"])
    if stop is not None:
        spans.append(Span(stop, last_s))
    return spans if maintenance is None else [*spans, maintenance]


def _is_excused(outcome: Outcome, span: Span, look: Look) -> bool:
    """Return whether the board could not have heard of the stop yet, since
    the line was disturbed all along.
    """
    return not _is_heard(outcome, span, look)


def _is_heard(outcome: Outcome, span: Span, look: Look) -> bool:
    """Return whether the line and the daemon were well for long enough between the stop and the look."""
    well_s = span.begin_s
    bad = sorted(_disturbances(outcome), key=lambda each: each.begin_s)
    if not any(each.begin_s <= span.begin_s + OBEYED_S and each.end_s >= span.begin_s for each in bad):
        return True
    for each in bad:
        if each.begin_s - well_s >= REPAIRED_S and each.begin_s <= look.time_s:
            return True
        if each.end_s > well_s:
            well_s = each.end_s
    return look.time_s - well_s >= REPAIRED_S


def _disturbances(outcome: Outcome) -> list[Span]:
    """Stretches in which the line, the board or the daemon can be late for reasons of the plan."""
    spans = [
        Span(
            fault["start_s"] - 3.0,
            fault["start_s"] + fault.get("duration_s", 0.0) + fault.get("delay_s", 0.0),
        )
        for fault in outcome.plan.faults
        if fault["name"] in LINE
    ]
    for fault in outcome.plan.faults:
        if fault["name"] in BOARD:
            each = fault.get("period_s", 0.0) + fault.get("boot_time_s", 0.0)
            spans.append(Span(fault["start_s"] - 3.0, fault["start_s"] + each * fault.get("count", 1)))
    for lived, after in zip(outcome.lives, outcome.lives[1:], strict=False):
        spans.append(Span(lived.end_s - 1.0, after.begin_s))
    return spans


def _numbers(outcome: Outcome) -> Iterator[str]:
    """Every tick is stored once or reported missing; a restart continues the numbers."""
    given_out = 0
    for number, lived in enumerate(outcome.lives):
        if lived.seqs and lived.seqs[0] <= given_out:
            yield f"life {number} gives out the number {lived.seqs[0]} again, {given_out} was the last"
        given_out = max([given_out, *lived.seqs])
    last = outcome.lives[-1]
    expected = 1
    for first_seq, last_seq in sorted([*((seq, seq) for seq in last.stored), *last.gaps]):
        if first_seq > expected:
            yield f"ticks {expected} to {first_seq - 1} are neither stored nor reported missing"
        elif first_seq < expected:
            yield f"tick {first_seq} is in the history and reported missing, or missing twice"
        if last_seq - first_seq > MISSING_MAX:
            yield f"ticks {first_seq} to {last_seq} are reported missing: more than can have been"
        expected = last_seq + 1
    if given_out >= expected:
        yield f"ticks {expected} to {given_out} are neither stored nor reported missing at the end"


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """Each scenario with its violations, in the order of the seeds."""
    yield from sweep(one, range(seed, seed + count), WORKERS)


def one(seed: int) -> TrialResult:
    """One scenario."""
    with tempfile.TemporaryDirectory(prefix="gh-attack-") as name:
        try:
            found = violations(live(draw(seed), Path(name)))
        except Exception as error:
            found = [f"the scenario itself failed: {error!r}"]
    return TrialResult(f"seed {seed}", 1, found)


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 1000, "scenarios", __doc__))
