"""Who may import whom: one list of layers that keeps the house standing, lazy imports included. And its size.

`python -m tests.test_imports` prints the table of lines and modules as it is now.
"""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
# Rooms of edge/ from top to bottom: each imports only rooms of lines below its own, so nothing is circular.
# Rooms on one line do not import each other.
LAYERS = (
    ("commands",),
    ("page",),
    ("app", "evidence", "lab"),
    ("mqtt", "sockets"),
    ("state",),
    ("assistant",),
    ("storage",),
    ("controllers",),
    ("bundle",),
    ("forecasts", "drift"),
    ("diagnosis", "data_intake"),
    ("models",),
    ("tick",),
    ("twin",),
    ("safety",),
    ("board",),
    ("config",),
    ("formats",),
    ("core",),
)
RANK = {room: rank for rank, line in enumerate(LAYERS) for room in line}
# Rooms of fleet/, as above; the files beside them are above all but `commands`.
FLEET = (
    ("commands",),
    ("machine",),
    ("page",),
    ("jobs",),
    ("ingest", "rollout"),
    ("numbers",),
    ("database",),
)
TRAINING = {"data", "models", "export", "evaluate", "rl", "control", "llm_stand_in"}
WIRE = {
    "edge/board/board.py",
    "edge/board/board_file.py",
    "edge/board/board_session.py",
    "edge/board/board_tool.py",
    "edge/board/firmware_file.py",
    "edge/board/output_check.py",
    "edge/board/wiring.py",
}  # line and block of the board
FORBIDDEN = {  # part of the tree -> what nothing in it may import
    "firmware_protocol": ("edge", "training", "torch"),
    "edge": ("fleet", "training", "torch", "stable_baselines3", "tests", "bench"),
    "fleet": ("training", "torch", "tests", "bench"),
    "training": ("tests", "bench"),
    "firmware_protocol/virtual_board/chamber.py": ("edge",),
    # The control thread encodes nothing: whoever writes to the wire or the disk does, in a thread of its own.
    "edge/tick/loop.py": ("json", "edge.formats", "edge.state", "edge.tick.orders_json"),
}
# Values in, values out: no file, port, thread or clock.
PURE = (
    "core/messages.py",
    "core/names.py",
    "core/controller.py",
    "core/predictor.py",
    "core/horizons.py",
    "safety",
    "tick/calibration.py",
    "tick/orders.py",
    "tick/reference.py",
    "tick/light_and_water.py",
    "tick/estimator.py",
    "tick/steering.py",
    "formats/tick_json.py",
    "twin",
    "models/policy_observation.py",
    "models/policy_actions.py",
    "controllers/rl.py",
    "controllers/external.py",
    "drift",
    "forecasts",
    "lab/cost.py",
    "lab/episodes.py",
    "lab/environment.py",
)
WORLD = ("serial", "socket", "sqlite3", "sqlite_utils", "paho", "requests", "time", "threading", "subprocess")
FOLDERS = ("bench", "docs", "edge", "examples", "firmware_protocol", "fleet", "tests", "tools", "training")
SIZES = {  # room: lines and modules of Python. At 02ed168c there were 181 662 lines in 1 263 modules.
    "bench": (2_940, 18),
    "bench/attack": (2_328, 12),
    "bench/boxes": (1_934, 9),
    "bench/fleet_rollout": (689, 5),
    "bench/foreign": (1_540, 9),
    "bench/real_truth": (1_150, 5),
    "bench/wishes": (350, 3),
    "edge": (189, 2),
    "edge/app": (4_600, 22),
    "edge/assistant": (3_587, 25),
    "edge/board": (1_976, 12),
    "edge/bundle": (1_972, 15),
    "edge/commands": (4_301, 37),
    "edge/config": (910, 6),
    "edge/controllers": (2_937, 22),
    "edge/core": (1_017, 16),
    "edge/data_intake": (954, 7),
    "edge/diagnosis": (6_998, 44),
    "edge/drift": (682, 7),
    "edge/evidence": (1_547, 10),
    "edge/forecasts": (596, 5),
    "edge/formats": (1_877, 14),
    "edge/lab": (807, 8),
    "edge/models": (1_356, 13),
    "edge/mqtt": (1_620, 9),
    "edge/page": (4_183, 39),
    "edge/safety": (1_178, 7),
    "edge/sockets": (668, 6),
    "edge/state": (593, 4),
    "edge/storage": (2_259, 13),
    "edge/tick": (3_400, 19),
    "edge/twin": (3_881, 24),
    "firmware_protocol": (2_179, 13),
    "firmware_protocol/virtual_board": (3_692, 25),
    "fleet": (185, 3),
    "fleet/commands": (535, 8),
    "fleet/database": (531, 4),
    "fleet/ingest": (1_466, 11),
    "fleet/jobs": (200, 3),
    "fleet/machine": (1_507, 14),
    "fleet/numbers": (203, 3),
    "fleet/page": (1_144, 10),
    "fleet/rollout": (1_183, 9),
    "tests": (1_340, 14),
    "tests/bench": (1_943, 14),
    "tests/conformance": (2_320, 18),
    "tests/deploy": (1_854, 13),
    "tests/edge": (44_270, 195),
    "tests/firmware_protocol": (7_530, 27),
    "tests/fleet": (4_839, 29),
    "tests/hardware_in_the_loop": (874, 11),
    "tests/real_home_assistant": (746, 6),
    "tests/support": (5_691, 52),
    "tests/training": (3_906, 15),
    "tools": (856, 5),
    "training": (564, 3),
    "training/control": (1_908, 11),
    "training/data": (464, 5),
    "training/evaluate": (2_133, 14),
    "training/export": (971, 7),
    "training/llm_stand_in": (585, 5),
    "training/models": (1_584, 13),
    "training/rl": (1_965, 20),
}
SLACK = 0.02  # by how much a room may lie below its row before the row must be lowered
HEAVY = ("scipy", "sqlite_utils", "matplotlib", "rich", "onnxruntime", "requests", "pandas", "cryptography")


def sources(part: str) -> list[Path]:
    path = ROOT / part
    return [path] if path.is_file() else sorted(path.rglob("*.py"))


@functools.cache
def imported(path: Path) -> set[str]:
    """Modules that a file imports anywhere in it, dotted."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def under(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def test_edge_holds_rooms_alone_and_each_is_in_the_list() -> None:
    loose = {path.name for path in (ROOT / "edge").glob("*.py")}
    rooms = {path.parent.name for path in (ROOT / "edge").glob("*/__init__.py")}
    assert loose == {"__init__.py", "__main__.py"}
    assert rooms == set(RANK)


def test_training_holds_rooms_alone() -> None:
    loose = {path.name for path in (ROOT / "training").glob("*.py")}
    rooms = {path.parent.name for path in (ROOT / "training").glob("*/__init__.py")}
    assert loose == {"__init__.py", "__main__.py", "lab.py"}
    assert rooms == TRAINING


def test_only_the_lab_runs_a_daemon_in_simulated_time() -> None:
    wiring = {
        str(path.relative_to(ROOT))
        for part in ("training", "bench", "tests")
        for path in sources(part)
        if {"edge.app.daemon.Daemon", "edge.board.sim_clock.SimClock"} <= imported(path)
    }
    # The second measures the memory of a process that holds a daemon and nothing else.
    assert wiring == {"training/lab.py", "bench/default_daemon.py"}


def upward(package: str, room: str, rank: dict[str, int]) -> list[str]:
    """Imports of a room that lead to rooms beside or above it."""
    return [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in sources(f"{package}/{room}")
        for module in imported(path)
        if module.startswith(f"{package}.")
        and (other := module.split(".")[1]) in rank
        and other != room
        and rank[other] <= rank[room]
    ]


@pytest.mark.parametrize("room", RANK)
def test_a_room_imports_only_rooms_below_it(room: str) -> None:
    assert upward("edge", room, RANK) == []


def test_fleet_holds_the_rooms_of_its_list() -> None:
    loose = {path.name for path in (ROOT / "fleet").glob("*.py")}
    assert loose == {"__init__.py", "command.py", "settings.py"}
    rooms = {path.parent.name for path in (ROOT / "fleet").glob("*/__init__.py")}
    assert rooms == {room for line in FLEET for room in line}


@pytest.mark.parametrize("room", [room for line in FLEET for room in line])
def test_a_room_of_the_fleet_imports_only_rooms_below_it(room: str) -> None:
    assert upward("fleet", room, {name: rank for rank, line in enumerate(FLEET) for name in line}) == []


def test_a_room_says_what_belongs_in_it() -> None:
    rooms = [*(f"edge/{room}" for room in RANK), *(f"fleet/{room}" for line in FLEET for room in line)]
    silent = [
        path
        for path in rooms
        if len(ast.get_docstring(ast.parse((ROOT / path / "__init__.py").read_text())) or "") < 80
    ]
    assert silent == []


def test_no_file_imports_itself_by_a_detour() -> None:
    modules = {module_of(path): path for path in sources("edge")}
    below = {name: imported(path) & modules.keys() - {name, "edge"} for name, path in modules.items()}
    while leaves := {name for name, others in below.items() if not others}:
        below = {name: others - leaves for name, others in below.items() if name not in leaves}
    assert below == {}


@pytest.mark.parametrize("part", FORBIDDEN)
def test_nothing_imports_what_its_part_may_not(part: str) -> None:
    broken = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in sources(part)
        for module in imported(path)
        if any(under(module, package) for package in FORBIDDEN[part])
    ]
    assert broken == []


def test_only_the_board_knows_the_wire() -> None:
    knowing = {
        str(path.relative_to(ROOT))
        for path in sources("edge")
        if any(under(module, "firmware_protocol") for module in imported(path))
    }
    assert knowing == WIRE


@pytest.mark.parametrize("part", PURE)
def test_what_is_pure_does_not_touch_the_world(part: str) -> None:
    touched = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in sources(f"edge/{part}")
        for module in imported(path)
        if any(under(module, package) for package in WORLD)
    ]
    assert sources(f"edge/{part}")
    assert touched == []


def test_heavy_packages_are_not_in_a_daemon_that_runs() -> None:
    program = (
        "import sys, edge.app.daemon, edge.commands.run; "
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    out = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert out.stdout.strip() == "[]"


def sizes() -> dict[str, tuple[int, int]]:
    """Lines and modules of each room as they are."""
    return {room: _size(sorted(files)) for room, files in _rooms().items()}


def _size(files: list[Path]) -> tuple[int, int]:
    return sum(len(path.read_text().splitlines()) for path in files), len(files)


def _rooms() -> dict[str, list[Path]]:
    rooms: dict[str, list[Path]] = {}
    for path in _modules():
        parts = path.relative_to(ROOT).parts
        rooms.setdefault("/".join(parts[:2] if len(parts) > 2 else parts[:1]), []).append(path)
    return rooms


def _modules() -> list[Path]:
    return [path for folder in FOLDERS for path in sources(folder)]


def test_no_room_grows_beyond_its_row() -> None:
    """A commit that needs more raises the row and gives the reason."""
    now = {room: (*size, *SIZES.get(room, (0, 0))) for room, size in sizes().items()}
    assert {room: size for room, size in now.items() if size[0] > size[2] or size[1] > size[3]} == {}


def test_a_room_that_shrank_has_a_lower_row() -> None:
    now = sizes()
    loose = [
        room
        for room, (lines, _) in SIZES.items()
        if now.get(room, (0, 0))[0] < lines - max(50, SLACK * lines)
    ]
    assert loose == [], "`python -m tests.test_imports` prints the new rows"


if __name__ == "__main__":
    table = sizes()
    for name, (lines, modules) in sorted(table.items()):
        print(f'    "{name}": ({lines:_}, {modules}),')
    total = [sum(size[k] for size in table.values()) for k in (0, 1)]
    print(f"# {total[0]} lines in {total[1]} modules")
