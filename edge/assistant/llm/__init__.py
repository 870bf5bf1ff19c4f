"""A language model behind an OpenAI-compatible endpoint: asked, checked, never believed.

What it proposes passes the same safety as any other command; what it says is held against what it was shown.
"""
