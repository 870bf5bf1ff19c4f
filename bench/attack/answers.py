"""Evil answers of a language model's server: python -m bench.attack.answers --seed S --count N.

The whole daemon asks a server on the loopback that answers each request with something else that is wrong,
and that repeats the API key. The rig stays inside its limits, every tick is stored, the key is found nowhere.
"""

import base64
import json
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.attack.part import TrialResult, evil_document, evil_text, evil_value, main_of
from edge.board.virtual_rig import settings_in
from edge.config import loading as config
from edge.core.messages import TickRecord
from training.lab import Lab
from training.llm_stand_in.behaviours import BEHAVIOURS, Sending
from training.llm_stand_in.server import StandIn

KEY = "sk-attack-0123456789abcdefghijklmnopqrstuvwxyz"
KEYS = (KEY, base64.b64encode(KEY.encode()).decode().rstrip("="), KEY.encode().hex())
CONTROLLERS = ("LLM-Te0", "LLM-SQL-Te0", "LLM-Linear-Te0")
YAML = """
timezone: UTC
reference: {kind: constant, reference_c: 28}
control: {decision_deadline_s: 0.5}
drift: {enabled: false}
"""
MARGIN_K = 8.0  # the fallback holds the reference; hotter than this above it, something let heat through


class EvilServer(StandIn):
    """Answers each request with what its generator draws."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__()
        self._rng = rng

    def sending(self, body: dict[str, Any]) -> Sending:
        """One evil answer."""
        rng = self._rng
        kind = int(rng.integers(5))
        # Hanging servers are tried elsewhere: each would take its whole deadline here.
        if kind == 0:
            return BEHAVIOURS[str(rng.choice(sorted(BEHAVIOURS.keys() - {"hanging", "dripping", "slow"})))](
                body, 0
            )
        answer = {"heater_duty": 0.5, "fan_on": False, "rationale": f"Because. {KEY}"}
        message: dict[str, Any] = {
            "role": "assistant",
            "content": evil_document(rng, answer).decode(errors="surrogateescape"),
        }
        if kind == 1:
            message = {
                "role": "assistant",
                "content": None,
                "refusal": f"{evil_text(rng)} {rng.choice(KEYS)}",
            }
        elif kind == 2:
            arguments = evil_document(rng, {"query": "SELECT 1", "heater_duty": [1] * 10, "fan_on": [0] * 10})
            call = {"name": str(rng.choice(["query", "simulate", "sql", evil_text(rng)[:50]])),
                    "arguments": arguments.decode(errors="surrogateescape")}  # fmt: skip
            message |= {"tool_calls": [{"id": evil_text(rng)[:60], "type": "function", "function": call}]}
        elif kind == 3:
            message["content"] = json.dumps(answer | {"rationale": evil_text(rng) + str(rng.choice(KEYS))})
        reply = {
            "choices": [{"index": 0, "message": message, "finish_reason": "stop"}],
            "usage": {"prompt_tokens": evil_value(rng, 3), "completion_tokens": 1},
        }
        raw = evil_document(rng, reply) if kind == 4 else json.dumps(reply).encode()
        headers = {"Retry-After": str(rng.choice(["1e9", "nan", "-1", KEY]))} if rng.random() < 0.2 else {}
        return Sending(raw, int(rng.choice([200, 200, 200, 200, 500, 429, 302, 204])), headers)


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """One run of each architecture, `count` answers in all."""
    for number, controller in enumerate(CONTROLLERS):
        ticks = -(-count // len(CONTROLLERS))
        yield TrialResult(
            f"{controller}, seed {seed + number}", ticks, _violations(controller, seed + number, ticks)
        )


def _violations(controller: str, seed: int, ticks: int) -> list[str]:
    with tempfile.TemporaryDirectory(prefix="gh-evil-") as name:
        folder = Path(name)
        key_file = folder / "key"
        key_file.write_text(KEY)
        key_file.chmod(0o600)
        with EvilServer(np.random.default_rng(seed)) as server:
            settings = settings_in(folder, config.parse(YAML))
            llm = replace(
                settings.llm, url=server.url, model="evil", key_file=str(key_file), retries=0, backoff_s=0.0,
                timeout_s=0.4,
            )  # fmt: skip
            control = replace(settings.control, controller=controller)
            settings = replace(settings, llm=llm, control=control)
            with Lab(settings, folder=folder, recorded=True) as lab:
                lab.run(ticks=ticks)
                hottest = lab.board.truth()["hottest_air_c"]
        records = lab.history
        found = [f"{len(records)} of {ticks} ticks"] if len(records) != ticks else []
        if hottest > 28.0 + MARGIN_K:
            found.append(f"air at {hottest:.1f} °C")
        return found + _in_history(folder / "history.db", records) + _keys_in(folder)


def _in_history(path: Path, records: list[TickRecord]) -> list[str]:
    """Check that the history holds the ticks that were run and that its text can be read."""
    with closing(sqlite3.connect(path)) as connection:
        seqs = [seq for (seq,) in connection.execute("SELECT seq FROM ticks ORDER BY seq")]
        connection.execute("SELECT group_concat(text) FROM events").fetchone()[0].encode()
        lost = connection.execute("SELECT count(*) FROM events WHERE key = 'history.ticks_lost'").fetchone()[
            0
        ]
    missing = set(record.seq for record in records) - set(seqs)
    found = [f"ticks that are not stored: {sorted(missing)}"] if missing else []
    return [*found, f"{lost} times ticks were lost"] if lost else found


def _keys_in(folder: Path) -> list[str]:
    return [
        f"the API key is in {path.name}"
        for path in folder.iterdir()
        if path.is_file() and path.name != "key" and any(key.encode() in path.read_bytes() for key in KEYS)
    ]


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 100, "answers", __doc__))
