"""One step each: load, call metrology, save."""
