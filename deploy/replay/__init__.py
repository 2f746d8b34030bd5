"""A recording played to the nodes again: what they decided must come out bit for bit."""
