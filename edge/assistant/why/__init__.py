"""Why a command was sent, told from what was recorded of the tick; no model is asked."""
