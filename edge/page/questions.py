"""Questions to the twin: `greenhouse what-if` as a process of its own, for this one never holds numpy.

One at a time, with little of the processor and of its time, and the answer stays for whoever asks the same: a
crowd of viewers costs the daemon's computer no more than a few answers a minute.
"""

import asyncio
import os
import sys
import time
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path

from edge.core.errors import RequestError
from edge.core.event_log import Allowance
from edge.core.plain_text import plain
from edge.formats.reader import DocumentError, parse_json
from edge.page.answers import Json, NotAllowed, number, text

OPTIONS = {  # key of a question -> option of the command, decimals; each is a number
    "heater_w": ("--heater-w", 1),
    "wall_factor": ("--wall-factor", 3),
    "walls_mm": ("--walls-mm", 2),
    "fan": ("--fan", 2),
    "reach_c": ("--reach", 1),
    "hold_c": ("--hold", 1),
    "room_c": ("--room", 1),
    "start_c": ("--from", 1),
}
NEEDED = ("reach_c", "room_c")
WALL, WALL_MAX = "wall", 40  # key, and length of its text
ANSWER_MAX_S = 30.0  # 0.7 s on a desktop, some seconds on a Raspberry Pi Zero
ANSWER_BYTES_MAX = 64 << 10
BURST, EVERY_S = 6, 10.0  # answers that are computed: at once; at length [s]
WAITING_MAX = 4
KEEP_S, KEEP_MAX = 300.0, 32  # a new twin is seen after so long
NICE = 5  # where nice may be; more would starve it on a busy machine until it is too late
COMMAND = (sys.executable, "-P", "-m", "edge", "what-if", "--json")
# One thread, as its stacks and buffers count as this service's memory.
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}


@dataclass(slots=True)
class TwinQuestions:
    """Asks the command with the configuration `config`, "" for every default."""

    config: str
    answers: OrderedDict[tuple[str, ...], tuple[float, Json]] = field(default_factory=OrderedDict)
    allowance: Allowance = field(default_factory=lambda: Allowance(BURST, 1.0 / EVERY_S, time.monotonic))
    one: asyncio.Lock = field(default_factory=asyncio.Lock)
    waiting: int = 0

    async def ask(self, words: tuple[str, ...]) -> Json:
        """Return the answer. words : options. Errors: RequestError by the twin, NotAllowed in a crowd"""
        if self.waiting >= WAITING_MAX:
            raise NotAllowed(HTTPStatus.SERVICE_UNAVAILABLE, "others are asking the twin: try again soon")
        self.waiting += 1
        try:
            async with self.one:
                return await self._ask(words)
        finally:
            self.waiting -= 1

    async def _ask(self, words: tuple[str, ...]) -> Json:
        known_s, known = self.answers.get(words, (float("-inf"), {}))
        if time.monotonic() - known_s > KEEP_S:
            if not self.allowance.take():
                reason = f"the twin answers one new question in {EVERY_S:g} s: try again soon"
                raise NotAllowed(HTTPStatus.TOO_MANY_REQUESTS, reason)
            config = ("--config", self.config) if self.config else ()
            known = await run_command((*COMMAND, *config, *words))
            self.answers[words] = time.monotonic(), known
            while len(self.answers) > KEEP_MAX:
                self.answers.popitem(last=False)
        if not known["ok"]:
            raise RequestError(known["error"])
        return known


async def run_command(command: tuple[str, ...]) -> Json:
    """Return the JSON that a command prints, or its reason for refusing. Errors: RequestError"""
    process = await asyncio.create_subprocess_exec(
        *command,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, **ENVIRONMENT},
        preexec_fn=_step_back,
    )
    try:
        async with asyncio.timeout(ANSWER_MAX_S):
            said, complaint = await process.communicate()
    except TimeoutError:
        raise RequestError(f"the twin gave no answer within {ANSWER_MAX_S:g} s") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    if process.returncode == 2:  # refused, in one line
        lines = complaint.decode(errors="replace").strip().splitlines() or ["no reason was given"]
        return {"ok": False, "error": plain(lines[-1].partition("what-if: ")[2] or lines[-1], 600)}
    try:
        return parse_json(said, "the twin's answer", ANSWER_BYTES_MAX)
    except DocumentError:
        raise RequestError(f"the twin's process ended by itself (code {process.returncode})") from None


def _step_back() -> None:
    """Let the daemon go first, and end this process where memory runs out. What a sandbox forbids is left."""
    with suppress(OSError):
        os.nice(NICE)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def options(given: Mapping[str, str]) -> tuple[str, ...]:
    """Return a question's options. Errors: RequestError"""
    if unknown := sorted(set(given) - {*OPTIONS, WALL}):
        raise RequestError(f"{plain(unknown[0], 40)}: unknown; known are {', '.join((*OPTIONS, WALL))}")
    words = []
    for key, (option, decimals) in OPTIONS.items():
        if key in given or key in NEEDED:
            # With "=", so that a value below 0 is no option; rounded, so that equal questions are seen.
            words.append(f"{option}={round(number(given, key), decimals):g}")
    if WALL in given:
        words.append(f"--wall={text(given, WALL, WALL_MAX)}")
    return tuple(words)
