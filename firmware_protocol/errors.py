"""Who broke the protocol: we (`LocalProtocolError`) or the other side (`RemoteProtocolError`)."""


class ProtocolError(Exception):
    """Root of both."""


class LocalProtocolError(ProtocolError):
    """This side asked for something the protocol cannot carry: a bug of our own."""


class RemoteProtocolError(ProtocolError):
    """The other side sent a whole frame that means nothing."""


class DecodeError(RemoteProtocolError):
    """A payload that is no message. `code` and `detail` are those of the error message that answers it."""

    def __init__(self, code: int, detail: int) -> None:
        super().__init__(f"error code {code}, detail {detail}")
        self.code = code
        self.detail = detail
