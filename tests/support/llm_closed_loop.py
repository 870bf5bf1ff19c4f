"""The whole daemon with a language model on a virtual board, in lock-step; its history afterwards."""

import json
import sqlite3
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from edge.board.virtual_rig import settings_in
from edge.config import loading as config
from edge.config.settings import Settings
from edge.core.messages import TickRecord
from training.lab import Lab

REFERENCE_C = 26.0
YAML = f"""
timezone: UTC
reference: {{kind: constant, reference_c: {REFERENCE_C}}}
control: {{decision_deadline_s: 1.0}}
drift: {{enabled: false}}
"""


@dataclass(frozen=True, slots=True)
class RunRemains:
    """The result of a run."""

    records: list[TickRecord]
    true_air_c: np.ndarray  # in the chamber, at each tick
    events: list[tuple[str, str]]  # key and text, as the history has them
    whys: list[dict[str, Any]]

    def texts(self, key: str) -> list[str]:
        """Texts of the history's events of one key."""
        return [text for found, text in self.events if found == key]

    @property
    def error_k(self) -> float:
        """Mean absolute error of the last ten minutes."""
        return float(np.abs(self.true_air_c[-10:] - REFERENCE_C).mean())


def run(
    controller: str,
    url: str,
    minutes: int,
    yaml: str = YAML,
    prepare: Callable[[Path], None] = lambda folder: None,
    during: Callable[[TickRecord, Lab], None] = lambda record, lab: None,
    **llm: Any,
) -> RunRemains:
    """`minutes` ticks of a minute.

    prepare : with the rig's folder, before the daemon starts
    during : after each tick
    llm : what differs from the settings for a server at `url`
    """
    with tempfile.TemporaryDirectory(prefix="gh-llm-") as name:
        folder = Path(name)
        settings = _settings(folder, controller, url, yaml, llm)
        prepare(folder)
        with Lab(
            settings,
            folder=folder,
            recorded=True,
            with_truth=True,
            # Called late: `lab` is bound before the first tick.
            on_tick=lambda record: during(record, lab),
        ) as lab:
            lab.run(minutes)
        return _remains(lab)


def _settings(folder: Path, controller: str, url: str, yaml: str, llm: dict[str, Any]) -> Settings:
    settings = settings_in(folder, config.parse(yaml))
    return replace(
        settings,
        control=replace(settings.control, controller=controller),
        llm=replace(settings.llm, url=url, **{"model": "stand-in", "backoff_s": 0.0, "retries": 0, **llm}),
    )


def _remains(lab: Lab) -> RunRemains:
    with closing(sqlite3.connect(lab.settings.history.path)) as history:
        events = history.execute("SELECT key, text FROM events ORDER BY seq, number").fetchall()
        whys = [json.loads(why) for (why,) in history.execute("SELECT why FROM decisions ORDER BY seq")]
    return RunRemains(lab.history, lab.columns()["true_air_c"], events, whys)
