"""Cases with a truth: boxes of which the engine has nothing, and the virtual board's greenhouse."""
