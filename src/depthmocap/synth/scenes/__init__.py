"""What is around a person: rooms, furniture, things, other people."""
