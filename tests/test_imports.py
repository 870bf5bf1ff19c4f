"""Who may import whom: the table that keeps the house standing."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

WIRE = {"edge/board.py", "edge/clock.py", "edge/serial_port.py"}  # the only ones that know the board's line
FORBIDDEN = {  # part of the tree -> what nothing in it may import
    "firmware_protocol": ("edge", "training", "torch"),
    "edge": ("training", "torch", "stable_baselines3", "tests", "bench"),
    "training": ("tests", "bench"),
    "edge/bundle": (
        "edge.board",
        "edge.storage",
        "edge.mqtt",
        "edge.loop",
        "edge.rig",
        "edge.controllers",
        "edge.commands",
    ),
    "edge/controllers": ("edge.board", "edge.storage", "edge.mqtt", "edge.loop", "edge.rig", "edge.clock"),
    "edge/drift": (
        "edge.board",
        "edge.storage",
        "edge.mqtt",
        "edge.loop",
        "edge.rig",
        "edge.controllers",
        "edge.clock",
        "edge.bundle",
        "edge.settings",
    ),
    "edge/forecasts": (
        "edge.board",
        "edge.storage",
        "edge.mqtt",
        "edge.loop",
        "edge.rig",
        "edge.controllers",
        "edge.clock",
    ),
    "edge/llm": (
        "edge.board",
        "edge.mqtt",
        "edge.loop",
        "edge.rig",
        "edge.clock",
        "edge.safety",
        "edge.inbox",
        "edge.control_socket",
    ),
    "edge/models": (
        "edge.board",
        "edge.storage",
        "edge.mqtt",
        "edge.loop",
        "edge.rig",
        "edge.controllers",
        "edge.clock",
    ),
    "edge/policy": (
        "edge.board",
        "edge.storage",
        "edge.mqtt",
        "edge.loop",
        "edge.rig",
        "edge.commands",
        "edge.clock",
    ),
    "edge/twin": (
        "edge.board",
        "edge.storage",
        "edge.mqtt",
        "edge.loop",
        "edge.rig",
        "edge.controllers",
        "edge.models",
        "edge.clock",
    ),
    "firmware_protocol/virtual_board/chamber.py": ("edge",),
}
PURE = ("safety", "safety_rules", "safety_state", "thermal_supervision", "operation", "reference", "lighting",
        "watering", "estimator", "tick_json", "messages", "names", "policy/observation", "policy/actions",
        "controllers/rl", "controllers/external")  # fmt: skip
WORLD = ("serial", "socket", "sqlite3", "sqlite_utils", "paho", "requests", "time", "threading", "subprocess")
HEAVY = ("scipy", "sqlite_utils", "matplotlib", "rich", "onnxruntime", "requests", "pandas", "cryptography")


def sources(part: str) -> list[Path]:
    path = ROOT / part
    return [path] if path.is_file() else sorted(path.rglob("*.py"))


def imported(path: Path, top_level_only: bool = False) -> set[str]:
    """Modules that a file imports, dotted."""
    tree = ast.parse(path.read_text())
    nodes = tree.body if top_level_only else list(ast.walk(tree))
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def under(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


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
    assert knowing <= WIRE


@pytest.mark.parametrize("name", PURE)
def test_what_is_pure_does_not_touch_the_world(name: str) -> None:
    touched = [
        m for m in imported(ROOT / "edge" / f"{name}.py") if any(under(m, package) for package in WORLD)
    ]
    assert touched == []


def test_heavy_packages_are_not_in_a_daemon_that_runs() -> None:
    program = (
        "import sys, edge.daemon, edge.commands.run; "
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    out = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert out.stdout.strip() == "[]"
