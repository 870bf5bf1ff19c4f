"""What the drift monitor found, in a sentence."""

from datetime import datetime, tzinfo

from edge.core.messages import Drift, DriftState
from edge.drift.regimes import WORDS


def in_words(drift: Drift, zone: tzinfo | None) -> str:
    """`the twin disagrees since ..., mostly with the fan on: ...`; in `zone`, None: the machine's own."""
    if drift.state is DriftState.DISAGREES and drift.since_utc is not None:
        since = datetime.fromtimestamp(drift.since_utc, zone)
        sign = "warmer" if drift.error_k > 0.0 else "colder"
        return (
            f"the twin disagrees since {since:%Y-%m-%d %H:%M}, mostly {WORDS[drift.where]}: "
            f"there the air ends each step {abs(drift.error_k):.2f} K {sign} than it expects"
        )
    if drift.state is DriftState.UNKNOWN:
        return f"the twin is not judged: {drift.reason}"
    learning = f" ({drift.learnt:.0%} of its ordinary errors learnt)" if drift.learnt < 1.0 else ""
    return f"the twin agrees{learning}"
