"""Who is in the picture: bodies, garments, hair and shoes."""
