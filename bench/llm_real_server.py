"""The controllers against a real OpenAI-compatible server program: `python -m bench.llm_real_server`.

`transformers serve` from its package, in an environment of its own under out/, with a tiny model of random
weights made on the spot. It talks nonsense in valid wire format, which is the point: every answer must end
in a failure that is told, and the rig must not notice. No part of `make test`: it installs a package.
"""

import argparse
import os
import site
import subprocess
import time
import urllib.request
import venv
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bench.llm_closed_loop import REFERENCE_C, RunRemains, run
from bench.support.broker import free_port
from edge.assistant.llm.budget import Budget, Spending
from edge.assistant.llm.endpoint import Endpoint
from edge.assistant.llm.failure import LlmFailure
from edge.config.settings import LlmSettings

ROOT = Path(__file__).parents[1]
PLACE = ROOT / "out" / "llm_real"
RESULT = Path(__file__).parent / "results" / "llm_real_server.txt"
PACKAGE = "transformers[serving]"
CONTROLLERS = ("LLM-Te0", "LLM-SQL-Te0", "LLM-SQL-Te1", "LLM-Linear-Te0-P")
START_S = 180.0
ANSWER_TOKENS = 64  # the model has one token per byte and no sense when to end
YAML = f"""
timezone: UTC
control: {{decision_deadline_s: 4.0}}
drift: {{enabled: false}}
reference: {{kind: constant, reference_c: {REFERENCE_C}}}
"""
HEADER = f"{'controller':<18s} {'ticks':>5s} {'decided by':<22s} {'air, min..max':<15s} failures told"


def server_environment() -> Path:
    """Its python, with the package installed; torch is lent by the environment that runs this."""
    python = PLACE / "venv" / "bin" / "python"
    if not (PLACE / "venv" / "installed").exists():
        venv.create(PLACE / "venv", with_pip=True)
        (library,) = (PLACE / "venv" / "lib").glob("python3.*/site-packages")
        (library / "lent.pth").write_text("\n".join(site.getsitepackages()) + "\n")
        subprocess.run([python, "-m", "pip", "install", "--quiet", PACKAGE], check=True)
        (PLACE / "venv" / "installed").touch()
    return python


@contextmanager
def real_server(python: Path) -> Iterator[tuple[str, str]]:
    """Yield the base URL and the model's name, while the server runs."""
    model, port = PLACE / "model", free_port()
    subprocess.run([python, Path(__file__).with_name("llm_random_model.py"), model], check=True)
    command = [
        str(python.with_name("transformers")),
        "serve",
        str(model),
        "--device",
        "cpu",
        "--port",
        str(port),
    ]
    with (PLACE / "server.log").open("w") as log:
        offline = {**os.environ, "HF_HUB_OFFLINE": "1"}
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=offline)
    try:
        _wait_until_ready(process, f"http://127.0.0.1:{port}/health")
        yield f"http://127.0.0.1:{port}/v1", str(model)
    finally:
        process.terminate()
        process.wait(30.0)


def _wait_until_ready(process: "subprocess.Popen[bytes]", url: str) -> None:
    give_up = time.monotonic() + START_S
    while time.monotonic() < give_up:
        if process.poll() is not None:
            raise SystemExit(f"the server ended, see {PLACE / 'server.log'}")
        try:
            with urllib.request.urlopen(url, timeout=5.0):
                return
        except OSError:
            time.sleep(0.5)
    raise SystemExit(f"the server was not ready within {START_S:g} s")


def one_exchange(url: str, model: str, tokens: int) -> str:
    """Describe a single exchange; the model ends its answer by chance alone."""
    settings = LlmSettings(url=url, model=model, answer_tokens=tokens, timeout_s=60.0)
    budget = Budget(settings, Spending(""), lambda spent: None, time.time)
    try:
        reply = Endpoint(settings, budget).chat([{"role": "user", "content": "hello"}], temperature=1.0)
        text = f"finish_reason {reply.finish_reason}, {len(reply.content or '')} characters, {reply.usage}"
    except LlmFailure as failure:
        text = str(failure)
    return f"one exchange of at most {tokens} tokens: {text}"


def line_of(controller: str, ended: RunRemains) -> str:
    """One run in a line."""
    decided = Counter(record.decision.controller for record in ended.records)
    kinds = Counter(text.split(": ")[2] for text in ended.texts("controller.error"))
    air = f"{np.min(ended.true_air_c):.1f}..{np.max(ended.true_air_c):.1f} degC"
    who = ", ".join(f"{name} {count}" for name, count in sorted(decided.items()))
    told = ", ".join(f"{kind} {count}" for kind, count in sorted(kinds.items())) or "none"
    return f"{controller:<18s} {len(ended.records):5d} {who:<22s} {air:<15s} {told}"


def main(words: Sequence[str] | None = None) -> None:
    """Install, serve, run every architecture; print and keep the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, default=15, help="of simulated time for each controller")
    parser.add_argument("--out", type=Path, default=RESULT)
    arguments = parser.parse_args(words)
    python = server_environment()
    version = subprocess.run(
        [python, "-c", "import transformers; print(transformers.__version__)"],
        capture_output=True, text=True, check=True,
    ).stdout.strip()  # fmt: skip
    lines = [
        "# python -m bench.llm_real_server",
        f"# transformers serve {version}, a Llama of 2 layers with random weights: noise on a valid wire",
    ]
    with real_server(python) as (url, model):
        lines += [one_exchange(url, model, tokens) for tokens in (16, 2000)]
        lines += [HEADER]
        for controller in CONTROLLERS:
            ended = run(controller, url, arguments.minutes, YAML, model=model, answer_tokens=ANSWER_TOKENS)
            lines.append(line_of(controller, ended))
    print("\n".join(lines))
    arguments.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
