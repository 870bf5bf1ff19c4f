"""The rig as a Gymnasium environment: each step is a tick of the daemon, over edge/sockets."""

import json
import select
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import GreenhouseError
from edge.core.messages import Command
from edge.formats.reader import parse_json
from edge.models.policy_actions import action_of, command_of
from training.rl.reward import Weights, reward
from training.rl.vec_env import ACTION_SPACE, OBSERVATION_SPACE

Observation = NDArray[np.float32]
RETRY_S = 0.1
_CHUNK = 65536


class RigGone(GreenhouseError):
    """No daemon asks at the socket."""


class SocketEnv(gymnasium.Env[Observation, np.int64]):
    """`step` proposes an action and waits for the next tick.

    The reward is that of the command which the board confirmed, on the filtered air temperature at the end of
    the step. `info` holds `driven_action`, the action that comes nearest to that command; `used`, whether
    the daemon took the proposal; `gap`, whether ticks went by unasked, so that nothing can be learnt.

    patience_s : without a question; then RigGone
    """

    metadata = {"render_modes": []}  # noqa: RUF012
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, path: Path, weights: Weights, reward_scale: float, patience_s: float = 600.0) -> None:
        self._path, self._weights, self._scale = path, weights, reward_scale
        self._patience_s = patience_s
        self._line: _Line | None = None
        self._question: Mapping[str, Any] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Wait for a tick; the rig goes on as it is."""
        super().reset(seed=seed)
        self._question, _ = self._next()
        return _observation(self._question), {}

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Never the end of an episode."""
        before, command = self._question, command_of(int(action))
        answer = {"tick": before["tick"], "heater_duty": command.heater_duty, "fan_on": command.fan_on}
        if self._line is not None:
            self._line.send(answer)
        self._question, same_line = self._next()
        sent = self._question["last_sent"]
        driven = Command(heater_duty=sent["heater_duty"], fan_on=sent["fan_on"])
        error = np.array(self._question["temp_air_c"] - before["reference_c"])
        earned = reward(error, np.array(driven.heater_duty), np.array(float(driven.fan_on)), self._weights)
        info = {
            "driven_action": action_of(driven),
            "used": self._question["previous"] is not None,
            "gap": not same_line or self._question["tick"] != before["tick"] + 1,
            "error_k": float(error),
        }
        return _observation(self._question), float(self._scale * earned), False, False, info

    def close(self) -> None:
        """Hang up; the fallback decides from the next tick on."""
        if self._line is not None:
            self._line.close()
            self._line = None

    def _next(self) -> tuple[Mapping[str, Any], bool]:
        """Return the next question, and whether it came over the same connection as the one before."""
        give_up_s = time.monotonic() + self._patience_s
        same_line = True
        while time.monotonic() < give_up_s:
            if self._line is None:
                same_line = False
                self._line = _Line.to(self._path)
            question = None if self._line is None else self._line.newest(give_up_s)
            if question is not None:
                return question, same_line
            self.close()
            time.sleep(RETRY_S)
        raise RigGone(f"{self._path}: no daemon has asked for {self._patience_s:g} s")


class _Line:
    """One connection."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._unread = connection, b""

    @classmethod
    def to(cls, path: Path) -> "_Line | None":
        """None while no daemon listens."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.connect(str(path))
        except OSError:
            connection.close()
            return None
        return cls(connection)

    def newest(self, give_up_s: float) -> Mapping[str, Any] | None:
        """Return the newest question, None when the daemon has hung up or is silent."""
        while b"\n" not in self._unread or self._is_readable(0.0):
            if not self._is_readable(give_up_s - time.monotonic()):
                return None
            try:
                data = self._connection.recv(_CHUNK)
            except OSError:
                data = b""
            if not data:
                return None
            self._unread += data
        *lines, self._unread = self._unread.split(b"\n")
        question = parse_json(lines[-1], "question")
        if "refused" in question:
            raise RigGone(f"refused: {question['refused']}")
        return question

    def send(self, answer: Mapping[str, Any]) -> None:
        """Send an answer. The wait for the next question notices a daemon that has ended."""
        try:
            self._connection.sendall(json.dumps(answer).encode() + b"\n")
        except OSError:
            return

    def close(self) -> None:
        self._connection.close()

    def _is_readable(self, timeout_s: float) -> bool:
        return bool(select.select([self._connection], [], [], max(0.0, timeout_s))[0])


def _observation(question: Mapping[str, Any]) -> Observation:
    return np.array(question["features"], dtype=np.float32)
