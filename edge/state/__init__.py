"""State that survives a restart: one store for small documents, written atomically.

What a document means stands with its owner: orders and trips in `edge.tick.standing`, the drift monitor's
memory in `edge.drift.state`, the forecasts' skill in `edge.forecasts.skill_state`.
"""
