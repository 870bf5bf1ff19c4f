"""All that a learner knows, as one file that is replaced whole: after a kill it goes on from the last one."""

import io
import json
import pickle
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.buffers import ReplayBuffer

from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically

FORMAT = 1
_COLUMNS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save(agent: DQN, facts: dict[str, Any], path: Path) -> None:
    """Write networks, optimiser, replay buffer, counters and random states. Errors: OSError.

    facts : JSON values, given back by `restore`
    """
    buffer = _replay_buffer(agent)
    kept = {name: torch.from_numpy(getattr(buffer, name)[: buffer.size()].copy()) for name in _COLUMNS}
    content = {
        "format": FORMAT,
        "policy": agent.policy.state_dict(),
        "optimizer": agent.policy.optimizer.state_dict(),
        "buffer": kept,
        "buffer_place": [buffer.pos, buffer.full],
        "steps": agent.num_timesteps,
        "updates": agent._n_updates,
        "calls": agent._n_calls,  # the target network is copied by this count
        "random": _random_states(agent),
        "facts": json.dumps(facts),
    }
    file = io.BytesIO()
    torch.save(content, file)
    write_atomically(path, file.getvalue())


def restore(agent: DQN, path: Path) -> dict[str, Any]:
    """Bring a fresh agent of the same settings to where `save` was called; the facts.

    Errors : DataError for a file that is none, or of another kind of agent
    """
    try:
        content = torch.load(path, weights_only=True)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise DataError(f"{path}: not a checkpoint of format {FORMAT}")
        agent.policy.load_state_dict(content["policy"])
        agent.policy.optimizer.load_state_dict(content["optimizer"])
    except (OSError, RuntimeError, EOFError, KeyError, ValueError, pickle.UnpicklingError) as error:
        raise DataError(f"{path}: not a checkpoint of this agent: {error}") from error
    buffer = _replay_buffer(agent)
    for name in _COLUMNS:
        rows = content["buffer"][name].numpy()
        getattr(buffer, name)[: len(rows)] = rows
    buffer.pos, buffer.full = content["buffer_place"]
    agent.num_timesteps = content["steps"]
    agent._n_updates, agent._n_calls = content["updates"], content["calls"]
    _set_random_states(agent, content["random"])
    facts: dict[str, Any] = json.loads(content["facts"])
    return facts


def _replay_buffer(agent: DQN) -> ReplayBuffer:
    assert agent.replay_buffer is not None  # a DQN makes it with itself
    return agent.replay_buffer


def _random_states(agent: DQN) -> dict[str, Any]:
    """Return the state of every random generator: numpy's (replay,
    exploration), torch's, the random actions'.
    """
    state = cast("tuple[Any, ...]", np.random.get_state(legacy=True))
    kind, keys, place, has_gauss, gauss = state
    return {
        "numpy": json.dumps([kind, keys.tolist(), place, has_gauss, gauss]),
        "torch": torch.get_rng_state(),
        "actions": json.dumps(agent.action_space.np_random.bit_generator.state),
    }


def _set_random_states(agent: DQN, states: dict[str, Any]) -> None:
    kind, keys, place, has_gauss, gauss = json.loads(states["numpy"])
    np.random.set_state((kind, np.array(keys, dtype=np.uint32), place, has_gauss, gauss))
    torch.set_rng_state(states["torch"])
    agent.action_space.np_random.bit_generator.state = json.loads(states["actions"])
