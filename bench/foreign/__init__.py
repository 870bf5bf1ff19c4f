"""A third generator of cases: physics, numbers and disturbances that the engine has not."""
