"""`greenhouse-train rl`, `rl-online` and `rl-gap`: their arguments, and what they print."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # importing torch takes a second, `--help` need not wait
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

POLICIES = Path("training/results/policies")
OFFLINE = ("RL-Off", "RL-Off-P")
ONLINE = ("RL-On-P", "RL-Tr-P")
MODELS = ("ham", "lstm", "pbm")
VARIANTS = 32  # of a model whose parameters are drawn


def add_commands(commands: "Commands") -> None:
    """All of them."""
    _add_offline(commands.add_parser("rl", help=_offline.__doc__, description=_offline.__doc__))


def _add_offline(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--variant", choices=OFFLINE, nargs="+", default=OFFLINE, help="usual: both")
    sub.add_argument(
        "--model", default="ham", metavar="MODEL", help=f"{', '.join(MODELS)} or a twin file (usual: ham)"
    )
    sub.add_argument("--seed", type=int, nargs="+", default=(0, 1, 2, 3, 4), help="usual: 0 to 4")
    sub.add_argument(
        "--randomise", action="store_true", help="draw the twin's parameters within their intervals"
    )
    sub.add_argument("--steps", type=int, help="of the environment (usual: 100000)")
    sub.add_argument("--out", type=Path, default=POLICIES, help=f"policies, records (usual: {POLICIES})")
    sub.set_defaults(run=_offline)


def _offline(arguments: argparse.Namespace) -> int:
    """policies learnt in a predictive model: DQN of 100 000 steps"""
    from dataclasses import replace

    from training.rl.settings import DqnSettings
    from training.rl.study import Job, study

    settings = DqnSettings()
    if arguments.steps is not None:
        settings = replace(settings, steps=arguments.steps)
    for variant in arguments.variant:
        for seed in arguments.seed:
            words = f"greenhouse-train rl --variant {variant} --model {arguments.model} --seed {seed}"
            words += " --randomise" if arguments.randomise else ""
            words += f" --steps {arguments.steps}" if arguments.steps is not None else ""
            variants = VARIANTS if arguments.randomise else 1
            job = Job(variant, arguments.model, seed, words, variants, settings)
            folder = folder_of(arguments.out, variant, arguments.model, seed, arguments.randomise)
            print(_line(study(job, folder)), flush=True)
    return 0


def folder_of(out: Path, variant: str, model: str, seed: int, randomised: bool) -> Path:
    """Where a training is kept under `out`."""
    where = f"{Path(model).stem}{'_randomised' if randomised else ''}"
    return out / variant.lower() / where / f"seed_{seed}"


def _line(record: dict[str, Any]) -> str:
    played = record["metrics"]["validation"]
    return (
        f"{record['variant']:9s} {record['model']:5s} seed {record['seed']}  MAE {played['mae_k']:.3f} K  "
        f"reward {played['reward']:.3f}  {record['wall_s']:.1f} s ({record['cpu_s']:.1f} s of CPU)"
    )
