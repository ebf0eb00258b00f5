"""The order of steps, and the command line."""
