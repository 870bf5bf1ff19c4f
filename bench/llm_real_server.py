"""The controllers against a real OpenAI-compatible server program: `python -m bench.llm_real_server`.

`transformers serve` from its package, in an environment of its own under out/, with a tiny model of random
weights made on the spot. It talks nonsense in valid wire format, which is the point: every answer must end
in a failure that is told, and the rig must not notice. No part of `make test`: it installs a package.
"""

import argparse
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bench.llm_closed_loop import REFERENCE_C, RunRemains, run
from edge.assistant.llm.budget import Budget, Spending
from edge.assistant.llm.endpoint import Endpoint
from edge.assistant.llm.failure import LlmFailure
from edge.config.settings import LlmSettings
from tests.support.llm_server import TRANSFORMERS, environment, transformers_server, version_of

ROOT = Path(__file__).parents[1]
PLACE = ROOT / "out" / "llm_real"
RESULT = Path(__file__).parent / "results" / "llm_real_server.txt"
CONTROLLERS = ("LLM-Te0", "LLM-SQL-Te0", "LLM-SQL-Te1", "LLM-Linear-Te0-P")
ANSWER_TOKENS = 64  # the model has one token per byte and no sense when to end
YAML = f"""
timezone: UTC
control: {{decision_deadline_s: 4.0}}
drift: {{enabled: false}}
reference: {{kind: constant, reference_c: {REFERENCE_C}}}
"""
HEADER = f"{'controller':<18s} {'ticks':>5s} {'decided by':<22s} {'air, min..max':<15s} failures told"


@contextmanager
def random_model_server() -> Iterator[tuple[str, str, str]]:
    """Yield the base URL, the model's name and the version of transformers, while the server runs."""
    python = environment(PLACE, (TRANSFORMERS,), lends_torch=True)
    model = PLACE / "model"
    subprocess.run([python, Path(__file__).with_name("llm_random_model.py"), model], check=True)
    with transformers_server(python, model.name, PLACE) as url:
        yield url, model.name, version_of(python, "transformers")


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
    with random_model_server() as (url, model, version):
        lines = [
            "# python -m bench.llm_real_server",
            f"# transformers serve {version}, a Llama of 2 layers with random weights: noise on a valid wire",
        ]
        lines += [one_exchange(url, model, tokens) for tokens in (16, 2000)]
        lines += [HEADER]
        for controller in CONTROLLERS:
            ended = run(controller, url, arguments.minutes, YAML, model=model, answer_tokens=ANSWER_TOKENS)
            lines.append(line_of(controller, ended))
    print("\n".join(lines))
    arguments.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
