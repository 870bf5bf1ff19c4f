"""The list of what survives a restart, SURVIVORS: every value, its file, its owner, how long it is valid.

Two things survive that are not values of the daemon: the history's ticks (edge/storage) and what the board
latches in its own memory, a stop and its trips, whatever becomes of these files.

Latched trips and a stop have stronger guarantees than the rest. The writer gets them in their own tick, an
order is acknowledged only when it is on the disk, and a write that failed is reported and tried again. A file
that can't be understood starts the rig in emergency stop. Everything else begins anew where its file is lost,
and may be as old as its row says.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from edge.assistant.llm.budget import Spending
from edge.bundle.roles import Roles
from edge.bundle.store import Admission
from edge.config.settings import Settings
from edge.core.errors import DataError
from edge.drift.monitor import DriftMemory
from edge.forecasts.skill import SkillState
from edge.formats.atomic_file import read_document
from edge.formats.reader import read
from edge.safety.memory import SafetyMemory
from edge.state import codecs
from edge.state.codecs import StandingState
from edge.storage.numbers import Reservation
from edge.tick.orders import Operation

Value = TypeVar("Value")


@dataclass(frozen=True)
class Survivor:
    """A value that survives.

    holds : its type; owner : the room that changes it; valid : how long, and what a kill may cost
    place : its file
    """

    holds: type
    owner: str
    valid: str
    place: Callable[[Settings], Path]


@dataclass(frozen=True)
class StoredValue(Survivor, Generic[Value]):
    """A survivor that the daemon restores at its start and saves through edge/state/writer.py.

    otherwise : the value where there is no file (why: "") or one that can't be understood (why: the reason)
    pause_s : between two writes, to spare a card [s]
    """

    encode: Callable[[Value], dict[str, Any]]
    decode: Callable[[dict[str, Any]], Value]
    otherwise: Callable[[Settings, str], Value]
    pause_s: float = 0.0


def restore(stored: StoredValue[Value], settings: Settings) -> Value:
    """Return the value of the process before; never raises."""
    path = stored.place(settings)
    try:
        values = read_document(path)
        return stored.otherwise(settings, "") if values is None else stored.decode(values)
    except Exception as error:  # whatever it is: half of a state is never used
        why = str(error) if isinstance(error, DataError) else repr(error)
        return stored.otherwise(settings, why if why.startswith(str(path)) else f"{path}: {why}")


def _beside(name: str) -> Callable[[Settings], Path]:
    return lambda settings: Path(settings.state_file).with_name(name)


def _no_orders(settings: Settings, why: str) -> StandingState:
    """Return the orders of a rig that cannot know them: it stands still."""
    return StandingState(
        Operation(settings.control.controller, emergency_stop=bool(why)), SafetyMemory(), why
    )


STANDING = StoredValue(
    StandingState,
    "tick (orders), safety (latched trips, the water of the last day)",
    "orders until changed, steering and maintenance to their end, trips until cleared; "
    "a kill costs nothing that was acknowledged",
    lambda settings: Path(settings.state_file),
    codecs.encode_standing,
    codecs.decode_standing,
    _no_orders,
)
SKILL = StoredValue(
    SkillState,
    "forecasts",
    "each score as long as its predictor has this version; a kill costs an hour",
    _beside("skill.json"),
    codecs.encode_skill,
    codecs.decode_skill,
    lambda settings, why: SkillState(),
)
DRIFT: StoredValue[DriftMemory | None] = StoredValue(
    DriftMemory,
    "drift",
    "as long as the twin is the one of its sha256; a kill costs an hour, never an alarm",
    _beside("drift.json"),
    codecs.encode_drift,
    codecs.decode_drift,
    lambda settings, why: None,
)
LLM_BUDGET = StoredValue(
    Spending,
    "assistant",
    "its UTC day; a kill costs a minute",
    _beside("llm_budget.json"),
    asdict,
    lambda values: read(Spending, values),
    lambda settings, why: Spending(""),
    pause_s=60.0,  # five exchanges a step would be five writes
)
# A separate file: earlier software would treat a state file with unknown keys as damaged.
LIMITS: StoredValue[Any] = StoredValue(
    codecs.Limits,
    "safety (water, heat, fan switches, relay proof), tick (releases, start of the reference)",
    "a day of water and heat, an hour of switches; a kill costs nothing, ten minutes of heat count as used",
    _beside("limits.json"),
    codecs.encode_limits,
    partial(read, codecs.Limits),
    lambda settings, why: why,
)
BOARD_ID: StoredValue[int | None] = StoredValue(
    int,
    "board",
    "until a person accepts another board; after a loss the first board that answers is pinned",
    _beside("board.json"),
    lambda board_id: {"board_id": board_id},
    lambda values: read(int, values.get("board_id"), key="board_id"),
    lambda settings, why: None,
)
STORED: tuple[StoredValue[Any], ...] = (STANDING, SKILL, DRIFT, LLM_BUDGET, BOARD_ID)
SURVIVORS: tuple[Survivor, ...] = (
    *STORED,
    LIMITS,
    # Written by their owners: the command line changes bundles too, without a daemon.
    Survivor(
        Roles,
        "bundle",
        "until a bundle is installed, activated, rejected or rolled back; a kill costs nothing",
        lambda settings: Path(settings.bundle.path) / "roles.json",
    ),
    Survivor(
        Admission,
        "bundle",
        "until the next bundle is installed; a kill costs nothing",
        lambda settings: Path(settings.bundle.path) / "admitted.json",
    ),
    Survivor(
        Reservation,
        "storage",
        "until the next tick numbers are reserved; overwritten in place, also on a full disk",
        lambda settings: Path(f"{settings.history.path}-numbers"),
    ),
)
