"""What depth sensors make of an exact picture."""
