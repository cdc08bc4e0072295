"""Results of a running capture on their way into other programs."""
