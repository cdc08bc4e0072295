"""Where depth cameras stand to each other, found from a person who moves in front of them."""
