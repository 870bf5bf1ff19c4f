"""Learning algorithms by name, for `greenhouse-train rl --algorithm`: a new one is its file and a row."""

from edge.core.errors import DataError
from training.rl.algorithms import dagger, dqn
from training.rl.algorithms.algorithm import Algorithm, learn_by
from training.rl.settings import DqnSettings

DQN = "DQN"  # the paper's: of its policies there are bundles and online training
ALGORITHMS = {
    DQN: Algorithm(DqnSettings(), learn_by(dqn.make_agent, dqn.network_of)),
    "DAgger": Algorithm(dagger.DaggerSettings(), dagger.learn),
}


def algorithm_of(name: str) -> Algorithm:
    """Return the row of a name. Errors: DataError"""
    if name not in ALGORITHMS:
        raise DataError(f"--algorithm: there is no {name!r}; known: {', '.join(ALGORITHMS)}")
    return ALGORITHMS[name]
