"""Controllers in closed loop on the virtual rig: references, runs, the best that is possible, comparison."""
