"""The physics of the box: base energy balance plus named effects; numpy alone, scipy late and only to fit."""
