"""The world that `fastslow train` learns in, for the loops of others: Gymnasium, vector environments, PettingZoo."""
