"""How a study file says things: its sections and their checks, sweeps, and objects in the words of a file."""
