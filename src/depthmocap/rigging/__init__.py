"""Setting up: from cameras that were just plugged in to a rig, while a person walks about."""
