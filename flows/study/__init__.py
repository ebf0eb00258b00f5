"""Studies: the paper's experiments repeated on simulated panels, and what captured scans tell without truth."""
