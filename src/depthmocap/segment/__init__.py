"""People in a room that several cameras see: what is not background, in clusters, followed over time."""
