"""Development set of passenger commands, its labelling conventions, and the score of an interpreter on it."""
