"""The daemon that runs on the rig. It never imports training/ or torch."""

from typing import TYPE_CHECKING, Any

from edge.core.version import __version__

if TYPE_CHECKING:
    from edge.diagnosis.python import DiagnosisResult, Run, Twin, diagnose

__all__ = ["DiagnosisResult", "Run", "Twin", "__version__", "diagnose"]


def __getattr__(name: str) -> Any:
    """Import the names that a notebook needs on first use; the daemon needs none of them."""
    if name in __all__:
        import edge.diagnosis.python

        return getattr(edge.diagnosis.python, name)
    raise AttributeError(f"module 'edge' has no attribute {name!r}")
