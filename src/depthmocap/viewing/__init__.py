"""Views of takes and of running captures in a browser."""
