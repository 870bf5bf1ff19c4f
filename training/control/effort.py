"""What it takes to have a controller: its own lines, settings that were tuned, knowledge, time to train.

python -m training.control.effort     prints the count
"""

import io
import json
import tokenize
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
EDGE, RESULTS = "edge/controllers", "training/results"
ARX_RECORD = f"{RESULTS}/trained/linear/interpolation/seed_0/result.json"


@dataclass(frozen=True, slots=True)
class Family:
    """A kind of controller.

    entry : that stands for it in the radar chart
    files : its own, folders with all their Python; what every controller uses is not among them
    tuned : settings that were chosen by trying, by name
    knowledge : 1 (none of the box, none of the method) to 5, and why
    records : JSON files and the key of each that add up to its time of training [s]
    """

    name: str
    entry: str
    files: tuple[str, ...]
    tuned: tuple[str, ...]
    knowledge: int
    why: str
    records: tuple[tuple[str, str], ...] = ()


FAMILIES = (
    Family(
        "rules", "rules", (f"{EDGE}/rules.py",), ("DEADBAND_K", "COOLING_DEADBAND_K"), 1,
        "two thresholds that anyone can read off a curve",
    ),
    Family(
        "PID", "PID", (f"{EDGE}/pid.py", "training/control/tune.py"),
        ("KP", "KI", "KD", "FAN_ON_K", "FAN_OFF_K"), 2,
        "feedback as taught everywhere; gains by a grid, windup and the fan's hand-over have to be known of",
    ),
    Family(
        "MPC", "MPC",
        (f"{EDGE}/mpc.py", f"{EDGE}/mixed_integer", "edge/models/arx.py", "edge/models/fit_arx.py"),
        ("horizon", "tail", "node_budget"), 4,
        "system identification and integer programming, none of the box's physics",
        ((ARX_RECORD, "wall_s"),),
    ),
    Family(
        "MPC-Twin", "MPC-Twin", (f"{EDGE}/mpc_twin.py", f"{EDGE}/twin_plan"),
        ("HORIZON", "TAIL", "WIDTH", "KIND_K", "MEASUREMENT_SD_K", "BODY_SD_K", "DISTURBANCE_SD_K"), 5,
        "heat transfer of the box (the twin), state estimation and search",
        ((f"{RESULTS}/paper_case/interpolation/diagnosis.json", "seconds"),),
    ),
    Family(
        "RL", "RL-Off", (f"{EDGE}/rl.py", "edge/models/onnx_policy.py", "edge/models/policy_actions.py",
         "edge/models/policy_contract.py", "edge/models/policy_observation.py", "edge/bundle/policies.py",
         "training/rl"),
        ("learning rate", "batch", "buffer", "exploration", "target update", "network", "lambda_1",
         "lambda_2", "lambda_0h", "lambda_0f"), 4,
        "reward design and the learner's many settings; of the box only a model to practise on",
        ((f"{RESULTS}/policies/rl-off/ham/seed_4/record.json", "wall_s"),),  # the one in the bundle
    ),
    Family(
        "LLM", "LLM-Te0", ("edge/assistant/llm",), ("prompt", "temperature"), 1,
        "the task in plain words; the model brings the rest",
    ),
)  # fmt: skip


def lines(files: Iterable[str], root: Path = ROOT) -> int:
    """Lines that hold code: no blank ones, no comments, no docstrings. A file that is not there has none."""
    return sum(_code_lines(path.read_text(encoding="utf-8")) for path in _sources(files, root))


def _sources(files: Iterable[str], root: Path) -> list[Path]:
    paths = [root / name for name in files]
    folders = [found for path in paths if path.is_dir() for found in sorted(path.rglob("*.py"))]
    return [path for path in paths if path.is_file()] + folders


def _code_lines(text: str) -> int:
    """A string that is a statement by itself is a docstring."""
    skipped = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    held: set[int] = set()
    statement: list[tokenize.TokenInfo] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.NEWLINE, tokenize.ENDMARKER):
            if not all(each.type == tokenize.STRING for each in statement):
                held |= {row for each in statement for row in range(each.start[0], each.end[0] + 1)}
            statement = []
        elif token.type not in skipped:
            statement.append(token)
    return len(held)


def training_s(family: Family, root: Path = ROOT) -> float:
    """Time to train, 0 where nothing is trained; infinite where it is not recorded."""
    total = 0.0
    for name, key in family.records:
        path = root / name
        if not path.is_file():
            return float("inf")
        total += float(json.loads(path.read_text(encoding="utf-8"))[key])
    return total


if __name__ == "__main__":
    for each in FAMILIES:
        counted = f"{lines(each.files):5d} lines, {len(each.tuned):2d} settings"
        print(f"{each.name:10s} {counted}, knowledge {each.knowledge} of 5")
