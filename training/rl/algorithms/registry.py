"""Learning algorithms by name, for `greenhouse-train rl --algorithm`: a new one is its file and a row."""

from edge.core.errors import DataError
from training.rl.algorithms import dagger, dqn, ppo, qr_dqn, sac
from training.rl.algorithms.algorithm import Algorithm, learn_by
from training.rl.settings import DqnSettings

DQN = "DQN"  # the paper's: of its policies there are bundles and online training
ALGORITHMS = {
    DQN: Algorithm(DqnSettings(), learn_by(dqn.make_agent, dqn.network_of)),
    "QR-DQN": Algorithm(qr_dqn.SETTINGS, learn_by(qr_dqn.make_agent, qr_dqn.network_of), qr_dqn.TRIALS),
    "PPO": Algorithm(ppo.SETTINGS, learn_by(ppo.make_agent, ppo.network_of), ppo.TRIALS),
    "SAC": Algorithm(sac.SETTINGS, learn_by(sac.make_agent, sac.network_of), sac.TRIALS),
    "DAgger": Algorithm(dagger.SETTINGS, dagger.learn, dagger.TRIALS),
}


def algorithm_of(name: str) -> Algorithm:
    """Return the row of a name. Errors: DataError"""
    if name not in ALGORITHMS:
        raise DataError(f"--algorithm: there is no {name!r}; known: {', '.join(ALGORITHMS)}")
    return ALGORITHMS[name]
