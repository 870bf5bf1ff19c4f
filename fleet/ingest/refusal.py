"""A message that is not believed, and why."""

from edge.core.errors import GreenhouseError


class Refused(GreenhouseError):
    """Not taken in.

    reason : one word of a few, by which refusals are counted; the text is for people
    history_id, seq : of the tick, "" and 0 where the message did not say
    """

    def __init__(self, reason: str, text: str, history_id: str = "", seq: int = 0) -> None:
        super().__init__(text)
        self.reason, self.history_id, self.seq = reason, history_id, seq
