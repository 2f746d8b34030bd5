"""Learning the policy. The only part of the fast system that imports torch."""
