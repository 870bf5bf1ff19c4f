"""The daemon that runs on the rig. It never imports training/ or torch."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from edge.python import Found, Run, Twin, diagnose

__version__ = "0.1.0"
__all__ = ["Found", "Run", "Twin", "diagnose"]


def __getattr__(name: str) -> Any:
    """What a notebook needs, imported when it is asked for: the daemon needs none of it."""
    if name in __all__:
        import edge.python

        return getattr(edge.python, name)
    raise AttributeError(f"module 'edge' has no attribute {name!r}")
