"""Model bundles: signed, versioned, and changed only by steps that a power cut can't leave half done.

Verify, install, load, try, activate and roll back. What a single model promises of itself stands with the
models, in `edge.models`.
"""
