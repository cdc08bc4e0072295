"""Random people: bodies, garments, hair and shoes."""
