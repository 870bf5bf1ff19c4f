"""Faults that show only in the air's temperature: how long until the alarm, how warm until then.

PYTHONPATH=.:tests/support python tests/hardware_in_the_loop/bounds.py prints the worst of both boards and
three seeds.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from run import ScenarioRun, run

from tests.support.watched_clock import TimedRequest

SEEDS = (1, 2, 3)
LOOK_S = 10.0


@dataclass(frozen=True, slots=True)
class BoundCase:
    """One entry of bounds.yaml. Times in s since the start, but `alarm_max_s`: since `begin_s`."""

    name: str
    fault: dict[str, Any]
    fault_s: float
    end_s: float
    temp_max_c: float
    alarm: str | None = None  # None: none is promised
    alarm_max_s: float = 0.0
    since_s: float = 0.0
    off_s: float | None = None
    reference: tuple[tuple[float, float], ...] = ((0, 26),)  # from a time [s] on, a temperature [°C]
    board: tuple[str, ...] = ()
    room_c: float = 21.2
    controller: str = "MPC"

    @property
    def begin_s(self) -> float:
        """When the fault begins to show."""
        return max(self.fault_s, self.since_s)

    def run(self, folder: Path, core: str, seed: int) -> ScenarioRun:
        """The case on one board."""
        steps = [{"at_s": at_s, "reference_c": reference_c} for at_s, reference_c in self.reference]
        return run(
            folder,
            self.end_s,
            core=core,
            seed=seed,
            faults=[{**self.fault, "start_s": self.fault_s}],
            orders=()
            if self.off_s is None
            else [TimedRequest(self.off_s, {"do": "set_mode", "mode": "off"})],
            settings={
                "reference": {"kind": "steps", "steps": steps},
                "watering": {"enabled": False},
                "control": {"controller": self.controller},
            },
            board=self.board,
            chamber={"room": {"temp_c": self.room_c}},
            look_s=LOOK_S,
        )

    def alarm_after_s(self, result: ScenarioRun) -> float | None:
        """Time until the alarm; None: it did not come [s]."""
        event = None if self.alarm is None else result.first(self.alarm)
        return None if event is None else event.time_s - self.begin_s


def cases() -> list[BoundCase]:
    """All of bounds.yaml."""
    return [
        BoundCase(**entry) for entry in yaml.safe_load((Path(__file__).parent / "bounds.yaml").read_text())
    ]


def table() -> Iterator[str]:
    """A line per case."""
    yield f"{'fault':38}{'alarm':26}{'after s':>10}{'bound':>7}{'hottest °C':>12}{'bound':>7}"
    for case in cases():
        with tempfile.TemporaryDirectory() as folder:
            runs = [
                case.run(Path(folder) / f"{core}{seed}", core, seed)
                for core in ("python", "c")
                for seed in SEEDS
            ]
        times = [time_s for result in runs if (time_s := case.alarm_after_s(result)) is not None]
        after = "-" if not times else f"{min(times):.0f}..{max(times):.0f}"
        bound = f"{case.alarm_max_s:.0f}" if case.alarm else "-"
        if case.alarm and len(times) < len(runs):
            after += "!"  # not in all runs
        hottest_c = max(result.hottest_c(case.fault_s) for result in runs)
        yield (
            f"{case.name:38}{case.alarm or '-':26}{after:>10}{bound:>7}"
            f"{hottest_c:12.1f}{case.temp_max_c:7.1f}"
        )


if __name__ == "__main__":
    for line in table():
        print(line, flush=True)
