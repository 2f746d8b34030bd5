"""The fast system: answers every observation with one action. Driving imports no torch; only `training` does."""
