"""Model bundles: signed, versioned, and changed only by steps that a power cut can't leave half done."""
